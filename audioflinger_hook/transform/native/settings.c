/* Whether settings fit one another: whatever they are, nothing behind them is read or written. */

#include "settings.h"

#include <math.h>

#include "analysis.h"

/* Three times the longest spectrum that there is: no sum or product of such sizes overflows. */
#define COUNT_MAX ((size_t)1 << 20)

static int finite_table(Table table)
{
    for (size_t entry = 0; entry < table.length; entry++)
        if (!isfinite(table.at[entry]))
            return 0;
    return 1;
}

static int is_recursion(Table b, Table a)
{
    return b.length == a.length && b.length >= 2 && b.length <= ORDER_MAX + 1 && a.at[0] == 1.0;
}

const char *settings_misfit(const Settings *s)
{
#define ENTRY(name)                                                                                \
    if (s->name > COUNT_MAX)                                                                       \
        return #name ": too large";
    COUNTS(ENTRY)
#undef ENTRY
#define ENTRY(name)                                                                                \
    if (isnan(s->name))                                                                            \
        return #name ": not a number";
    NUMBERS(ENTRY)
#undef ENTRY
#define ENTRY(name)                                                                                \
    if (s->name.length > COUNT_MAX || !finite_table(s->name))                                      \
        return #name ": too long, or not finite";
    TABLES(ENTRY)
#undef ENTRY
    if (s->window_frames < 1 || s->window.length != s->window_frames)
        return "window: not one entry a frame";
    if (s->decimation < 1 || s->steps < 1 || s->hop_frames != s->decimation * s->steps)
        return "hop_frames: not decimation x steps";
    if (s->hops_in_window < 1)
        return "hops_in_window: under 1";
    if (s->fft_length / 2 < s->window_frames)
        return "fft_length: under two windows";
    if (s->bins < 2 || s->bins > s->fft_length / 2 + 1)
        return "bins: not within the spectrum";
    if (s->first_bin < 1 || (s->last_bin >= s->first_bin && s->last_bin > s->bins - 2))
        return "first_bin, last_bin: without a bin to either side";
    if (s->partials_max < 1)
        return "partials_max: under 1";
    if (!is_recursion(s->band_b, s->band_a) || !is_recursion(s->low_b, s->low_a))
        return "band_b, band_a, low_b, low_a: not as long as one another, or not to 1";
    if (s->image_table.length < 1)
        return "image_table: empty";
    if (s->image_turn.length % 2 || s->image_turn.length / 2 > s->bins)
        return "image_turn: not two rows within the bins";
    if (s->attack.length != s->steps || s->glide.length != s->steps ||
        s->seconds.length != s->steps || s->glide_s.length != s->steps)
        return "attack, glide, seconds, glide_s: not one entry a step";
    if (s->phases.length < s->decimation || s->phases.length % s->decimation)
        return "phases: not rows of decimation";
    if (s->gain_table.length < 2 || !(s->gain_step_hz > 0.0))
        return "gain_table: under two entries, or gain_step_hz not above 0";
    if (s->loudness_weights.length && s->loudness_weights.length != s->bins)
        return "loudness_weights: neither none nor one a bin";
#define ENTRY(name)                                                                                \
    if (!isfinite(s->name))                                                                        \
        return #name ": not finite";
    FOLLOWER(ENTRY)
#undef ENTRY
    if (!(s->nothing > 0.0))
        return "nothing: not above 0";
    if (!(s->programme_min <= s->programme_start && s->programme_start <= s->programme_top))
        return "programme_start: not from programme_min to programme_top";
    return NULL;
}
