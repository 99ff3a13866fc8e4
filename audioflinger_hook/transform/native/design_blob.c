#include "design_blob.h"

#define MAGIC "CUSHLIVE"
#define FORMAT_VERSION 4
#define HEADER_BYTES 24
#define CHECKSUM_BYTES 8
#define RECORD_BYTES 48

enum { KIND_COUNT, KIND_NUMBER, KIND_ARRAY };

static uint32_t u32_at(const char *place)
{
    uint32_t value;
    memcpy(&value, place, sizeof value);
    return value;
}

/* Return the CRC-32 of ISO 3309, which zlib's crc32 also returns. Each table look-up processes four bits. */
static uint32_t crc32_of(const char *bytes, size_t length)
{
    uint32_t table[16];
    for (uint32_t entry = 0; entry < 16; entry++) {
        table[entry] = entry;
        for (int bit = 0; bit < 4; bit++)
            table[entry] = table[entry] >> 1 ^ (table[entry] & 1 ? UINT32_C(0xedb88320) : 0);
    }
    uint32_t crc = UINT32_C(0xffffffff);
    for (size_t at = 0; at < length; at++) {
        crc ^= (unsigned char)bytes[at];
        crc = crc >> 4 ^ table[crc & 15];
        crc = crc >> 4 ^ table[crc & 15];
    }
    return ~crc;
}

/* Return the address of a record's values, and set *count to their number. Return NULL if no record has this
 * name and kind, or if this record or an earlier record extends beyond the design. */
static char *values_of(Records records, const char *name, uint32_t kind, size_t *count)
{
    size_t at = 0;
    while (records.bytes - at >= RECORD_BYTES) {
        char *record = records.at + at;
        const uint64_t rows = u32_at(record + RECORD_NAME_BYTES + 4);
        const uint64_t columns = u32_at(record + RECORD_NAME_BYTES + 8);
        const uint64_t numbers = (rows ? rows : 1) * columns;
        at += RECORD_BYTES;
        if (numbers > (records.bytes - at) / 8)
            return NULL;
        if (!strncmp(record, name, RECORD_NAME_BYTES) && u32_at(record + RECORD_NAME_BYTES) == kind) {
            *count = (size_t)numbers;
            return record + RECORD_BYTES;
        }
        at += 8 * (size_t)numbers;
    }
    return NULL;
}

int record_count(Records records, const char *name, size_t *count)
{
    size_t numbers;
    const char *place = values_of(records, name, KIND_COUNT, &numbers);
    int64_t value = -1;
    if (place && numbers == 1)
        memcpy(&value, place, sizeof value);
    *count = (size_t)value;
    return value >= 0;
}

int record_number(Records records, const char *name, double *number)
{
    size_t numbers;
    const char *place = values_of(records, name, KIND_NUMBER, &numbers);
    if (place && numbers == 1)
        memcpy(number, place, sizeof *number);
    return place && numbers == 1;
}

int record_table(Records records, const char *name, Table *table)
{
    table->at = (double *)(void *)values_of(records, name, KIND_ARRAY, &table->length);
    return table->at != NULL;
}

const char *records_open(Records *records, void *bytes, size_t size)
{
    const char *at = bytes;
    if (__BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__)
        return "this processor is big-endian";
    if (size < HEADER_BYTES + CHECKSUM_BYTES || memcmp(at, MAGIC, 8))
        return "it is not a design";
    if ((uintptr_t)bytes % 8)
        return "it does not lie at a multiple of 8";
    if (u32_at(at + 8) != FORMAT_VERSION)
        return "it is of another version";
    if (u32_at(at + 12) != size || size % 8)
        return "it is cut or too long";
    if (u32_at(at + size - CHECKSUM_BYTES) != crc32_of(at, size - CHECKSUM_BYTES) ||
        u32_at(at + size - CHECKSUM_BYTES / 2) != 0)
        return "it is damaged: its checksum does not fit";
    *records = (Records){(char *)bytes + HEADER_BYTES, size - HEADER_BYTES - CHECKSUM_BYTES};
    return NULL;
}

