/* Loudness after ISO 532-1, from the excitation of its bands. */

#ifndef CUSHION_LOUDNESS_H
#define CUSHION_LOUDNESS_H

#include "settings.h"

/* Groups of bands whose rises count by themselves, at most. */
#define GROUPS_OF_BANDS_MAX 8

/* How loud a tick is. */
typedef struct {
    double db;   /* 0 for a full-scale tone of 1 kHz */
    double sone; /* of all bands */
    double groups[GROUPS_OF_BANDS_MAX]; /* sone of each, without what other bands mask */
} Heard;

/* Whether loudness is followed at all. */
int loudness_is_on(const Settings *settings);

size_t loudness_groups(const Settings *settings);

/* excitation: of each band, over its threshold in quiet. */
Heard loudness_of(const Settings *settings, const double *excitation);

#endif
