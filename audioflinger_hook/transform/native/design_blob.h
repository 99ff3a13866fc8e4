/* A design, read from the bytes that Python made (core/blob.py). */

#pragma once

#include "settings.h"

enum { RECORD_NAME_BYTES = 36 };

/* The records of a design, without header and checksum. */
typedef struct {
    char *at;
    size_t bytes;
} Records;

/* Find the records in the bytes of a design; return NULL, or what is wrong with the bytes. They must lie
 * at a multiple of 8, and stay unchanged as long as the design is used. Offsets and lengths are checked:
 * whatever the bytes are, nothing beyond them is read. */
const char *records_open(Records *records, void *bytes, size_t size);

INLINED int is_within(size_t count, size_t least, size_t most) { return count >= least && count <= most; }

/* Read a count, a number or a table; return 0 if there is no such record of this kind. */
int record_count(Records records, const char *name, size_t *count);
int record_number(Records records, const char *name, double *number);
int record_table(Records records, const char *name, Table *table);

/* Read the transform of a design, whose tables stay where they are; return NULL, or what is wrong with it.
 * All values are checked. */
const char *settings_read(Settings *settings, Records records);
