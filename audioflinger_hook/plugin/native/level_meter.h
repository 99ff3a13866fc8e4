/* Peak and mean square of the latest frames, as service/meters.py measures them. */

#ifndef CUSHION_LEVEL_METER_H
#define CUSHION_LEVEL_METER_H

#include <math.h>
#include <stddef.h>

#include "../../transform/native/exact.h"

#define RMS_TIME_S 0.3
#define PEAK_FALL_DB_PER_S 20.0
#define BELOW 2.8e-8 /* -151 dBFS counts as silence, so that nothing becomes denormal */

typedef struct {
    double samplerate;
    double peak, square;
} LevelMeter;

/* Take `count` samples, `step` apart, that last for `seconds`. */
static inline void level_take(LevelMeter *meter, const float *samples, size_t count, size_t step,
                              double seconds)
{
    double loudest = 0.0, sum = 0.0;
    if (!count)
        return;
    for (size_t at = 0; at < count; at++) {
        const float taken = samples[at * step];
        const double sample = isfinite(taken) ? fabs((double)taken) : 0.0;
        loudest = sample > loudest ? sample : loudest;
        sum += sample * sample;
    }
    const double keep = exact_exp(-seconds / RMS_TIME_S);
    const double held = meter->peak * exact_exp(-seconds * PEAK_FALL_DB_PER_S * M_LN10 / 20.0);
    const double square = keep * meter->square + (1.0 - keep) * sum / (double)count;
    meter->peak = loudest > held ? loudest : held;
    meter->peak = meter->peak > BELOW ? meter->peak : 0.0;
    meter->square = square > BELOW * BELOW ? square : 0.0;
}

/* All samples of some channels. */
static inline void level_add(LevelMeter *meter, const float *samples, size_t count, size_t channels)
{
    const double seconds = (double)count / (double)channels / meter->samplerate;
    level_take(meter, samples, count, 1, seconds);
}

/* One channel of several. */
static inline void level_add_channel(LevelMeter *meter, const float *samples, size_t frames,
                                     size_t channels)
{
    level_take(meter, samples, frames, channels, (double)frames / meter->samplerate);
}

#endif
