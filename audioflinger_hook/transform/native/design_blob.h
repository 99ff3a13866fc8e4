/* Reads the records of a design in the binary format of core/blob.py: named counts, numbers and tables. */

#pragma once

#include "common.h"

enum { RECORD_NAME_BYTES = 36 };

typedef struct {
    double *at;
    size_t length;
} Table;

INLINED int table_is_finite(Table table)
{
    size_t at = 0;
    while (at < table.length && isfinite(table.at[at]))
        at++;
    return at == table.length;
}

/* The bytes of a design between its header and its checksum. */
typedef struct {
    char *at;
    size_t bytes;
} Records;

/* Check alignment, header and checksum, and find the records; return NULL or an error message. The bytes must
 * be 8-byte aligned, and stay unchanged while the records are used. */
const char *records_open(Records *records, void *bytes, size_t size);

INLINED int is_within(size_t count, size_t least, size_t most) { return count >= least && count <= most; }

/* Make the function that contains this macro return `fault` unless `holds` is true. */
#define REQUIRE(holds, fault)                                                                      \
    do {                                                                                           \
        if (!(holds))                                                                              \
            return fault;                                                                          \
    } while (0)

/* Read the count, number or table `name`; return 1, or 0 if no valid record has this name and kind. */
int record_count(Records records, const char *name, size_t *count);
int record_number(Records records, const char *name, double *number);
int record_table(Records records, const char *name, Table *table);
