/* Converts between audio and vibration frequencies by the equations of mapping.py. */

#pragma once

#include "exact.h"
#include "settings.h"

INLINED double vibration_hz(const Settings *s, double audio_hz)
{
    const double octaves = exact_log(audio_hz / s->band_low_hz);
    return s->scale_ratio != 0.0 ? s->bottom_hz * exact_exp(s->scale_ratio * octaves)
                                 : s->scale_hz * octaves + s->bottom_hz;
}

INLINED double audio_hz(const Settings *s, double hz)
{
    const double octaves = s->scale_ratio != 0.0 ? exact_log(hz / s->bottom_hz) / s->scale_ratio
                                                 : (hz - s->bottom_hz) / s->scale_hz;
    return s->band_low_hz * exact_exp(octaves);
}

/* Interpolate linearly in a table; entry k belongs to k x step. Beyond the table, its end values apply. */
INLINED double table_at(Table table, double step, double at)
{
    const size_t last = table.length - 1;
    const double position = at / step;
    if (!(position > 0.0))
        return table.at[0];
    if (!(position < (double)last))
        return table.at[last];
    const size_t below = (size_t)position;
    const double slope = (table.at[below + 1] - table.at[below]) / step;
    return slope * (at - (double)below * step) + table.at[below];
}

/* Return the weight of amplitudes at a vibration frequency: the square root of the body's sensitivity. */
INLINED double tilt(const Settings *s, double hz)
{
    return sqrt(table_at(s->felt_weights, s->gain_step_hz, hz));
}
