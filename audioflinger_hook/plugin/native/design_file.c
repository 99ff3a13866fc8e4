/* Reads design files. Every offset and length is checked before it is used. */

#include "design_file.h"

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define MAGIC "CUSHLIVE"
#define FORMAT_VERSION 2
#define HEADER_BYTES 24
#define CHECKSUM_BYTES 8
#define NAME_BYTES 36
#define RECORD_BYTES 48
#define SIZE_MAX_BYTES ((long)64 << 20) /* designs have under 1 MB */

enum { KIND_COUNT, KIND_NUMBER, KIND_ARRAY };

static uint32_t u32_at(const char *place)
{
    uint32_t value;
    memcpy(&value, place, sizeof value);
    return value;
}

/* CRC-32 of ISO 3309, as zlib computes it. */
static uint32_t crc32_of(const char *bytes, size_t length)
{
    uint32_t crc = UINT32_C(0xffffffff);
    for (size_t at = 0; at < length; at++) {
        crc ^= (unsigned char)bytes[at];
        for (int bit = 0; bit < 8; bit++)
            crc = crc >> 1 ^ (crc & 1 ? UINT32_C(0xedb88320) : 0);
    }
    return ~crc;
}

/* A record's values, NULL where there is no such record of this kind. */
static const char *values_of(const char *bytes, size_t length, const char *name, uint32_t kind,
                             size_t *count)
{
    size_t at = HEADER_BYTES;
    while (length - at >= RECORD_BYTES) {
        const char *record = bytes + at;
        const uint64_t rows = u32_at(record + NAME_BYTES + 4);
        const uint64_t columns = u32_at(record + NAME_BYTES + 8);
        const uint64_t numbers = (rows ? rows : 1) * columns;
        at += RECORD_BYTES;
        if (numbers > (length - at) / 8)
            return NULL;
        if (!strncmp(record, name, NAME_BYTES) && u32_at(record + NAME_BYTES) == kind) {
            *count = (size_t)numbers;
            return record + RECORD_BYTES;
        }
        at += 8 * (size_t)numbers;
    }
    return NULL;
}

static int count_of(const char *bytes, size_t length, const char *name, size_t *count)
{
    size_t numbers;
    const char *place = values_of(bytes, length, name, KIND_COUNT, &numbers);
    int64_t value = -1;
    if (place && numbers == 1)
        memcpy(&value, place, sizeof value);
    *count = (size_t)value;
    return value >= 0;
}

static int number_of(const char *bytes, size_t length, const char *name, double *number)
{
    size_t numbers;
    const char *place = values_of(bytes, length, name, KIND_NUMBER, &numbers);
    if (place && numbers == 1)
        memcpy(number, place, sizeof *number);
    return place && numbers == 1;
}

static int table_of(char *bytes, size_t length, const char *name, Table *table)
{
    const char *place = values_of(bytes, length, name, KIND_ARRAY, &table->length);
    if (place)
        table->at = (double *)(bytes + (place - bytes)); /* every record lies at a multiple of 8 */
    return place != NULL;
}

static const char *take_settings(Design *design, char *bytes, size_t length)
{
    Settings *settings = &design->settings;
#define ENTRY(name)                                                                                \
    if (!count_of(bytes, length, #name, &settings->name))                                          \
        return "it lacks the count " #name;
    COUNTS(ENTRY)
#undef ENTRY
#define ENTRY(name)                                                                                \
    if (!number_of(bytes, length, #name, &settings->name))                                         \
        return "it lacks the number " #name;
    NUMBERS(ENTRY)
#undef ENTRY
#define ENTRY(name)                                                                                \
    if (!table_of(bytes, length, #name, &settings->name))                                          \
        return "it lacks the table " #name;
    TABLES(ENTRY)
#undef ENTRY
    if (!count_of(bytes, length, "samplerate", &design->samplerate) ||
        !count_of(bytes, length, "latency_frames", &design->latency_frames))
        return "it lacks samplerate or latency_frames";
    return settings_misfit(settings);
}

static const char *check(const char *bytes, size_t size)
{
    if (size < HEADER_BYTES + CHECKSUM_BYTES || memcmp(bytes, MAGIC, 8))
        return "it is not a design";
    if (u32_at(bytes + 8) != FORMAT_VERSION)
        return "it is of another version";
    if (u32_at(bytes + 12) != size || size % 8)
        return "it is cut or too long";
    if (u32_at(bytes + size - CHECKSUM_BYTES) != crc32_of(bytes, size - CHECKSUM_BYTES))
        return "it is damaged: its checksum does not fit";
    return NULL;
}

static char *contents(const char *path, size_t *size)
{
    char *bytes = NULL;
    FILE *file = fopen(path, "rb");
    if (!file)
        return NULL;
    long length = fseek(file, 0, SEEK_END) ? -1 : ftell(file);
    if (length > 0 && length <= SIZE_MAX_BYTES && !fseek(file, 0, SEEK_SET))
        bytes = malloc((size_t)length);
    if (bytes && fread(bytes, 1, (size_t)length, file) != (size_t)length) {
        free(bytes);
        bytes = NULL;
    }
    fclose(file);
    *size = bytes ? (size_t)length : 0;
    return bytes;
}

const char *design_read(Design *design, const char *path)
{
    const union {
        uint32_t number;
        char first;
    } order = {1};
    size_t size;
    memset(design, 0, sizeof *design);
    char *bytes = contents(path, &size);
    if (!bytes)
        return "it cannot be read";
    const char *problem = order.first ? check(bytes, size) : "this processor is big-endian";
    if (!problem)
        problem = take_settings(design, bytes, size - CHECKSUM_BYTES);
    if (problem) {
        free(bytes);
        return problem;
    }
    design->bytes = bytes;
    return NULL;
}

void design_close(Design *design)
{
    free(design->bytes);
    design->bytes = NULL;
}
