/* Loudness after ISO 532-1; tests/oracle/loudness.py has it to read. */

#include "loudness.h"

#include "common.h"
#include "exact.h"

/* Threshold factor of ISO 532-1. */
#define THRESHOLD 0.25

/* Loudness in phon of a full-scale tone of 1 kHz. */
#define FULL_SCALE_PHON 94.0

int loudness_is_on(const Settings *settings) { return settings->loudness_scale.length != 0; }

size_t loudness_groups(const Settings *settings)
{
    return settings->loudness_groups.length ? settings->loudness_groups.length - 1 : 0;
}

static double fourth_root(double number) { return sqrt(sqrt(number)); }

Heard loudness_of(const Settings *s, const double *excitation)
{
    Heard heard = {0.0, 0.0, {0.0}};
    double above = 0.0;
    size_t group = 0;
    for (size_t band = 0; band < s->loudness_scale.length; band++) {
        const double root = fourth_root(1.0 - THRESHOLD + THRESHOLD * excitation[band]);
        const double core = larger(0.0, s->loudness_scale.at[band] * (root - 1.0));
        const double width = s->loudness_widths.at[band];
        double tail = 0.0, left = 0.0;
        if (above > core) {
            const double slope = s->slope_a_bark / fourth_root(above);
            left = above * exact_exp(-slope * width);
            tail = (above - left) / slope;
        }
        heard.sone += larger(core * width, tail);
        above = larger(core, left);
        if ((double)band >= s->loudness_groups.at[group + 1])
            group++;
        heard.groups[group] += core * width;
    }
    const double phon = heard.sone >= 1.0 ? 40.0 + 10.0 * exact_log2(heard.sone)
                                          : 40.0 * exact_pow(heard.sone + 5e-4, 0.35);
    heard.db = phon - FULL_SCALE_PHON;
    return heard;
}
