/* Whether settings fit one another: whatever they are, nothing behind them is read or written. */

#include "settings.h"

#include <math.h>

#include "analysis.h"
#include "downmix.h"
#include "speech.h"

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

static int is_share(double number) { return number >= 0.0 && number <= 1.0; }

/* Whole numbers from 1 to the count of bins, each more than the last; at least two. */
static int are_edges(Table edges, size_t bins)
{
    for (size_t one = 0; one < edges.length; one++) {
        const double edge = edges.at[one], least = one ? edges.at[one - 1] + 1.0 : 1.0;
        if (!(edge >= least && edge <= (double)bins && edge == floor(edge)))
            return 0;
    }
    return edges.length >= 2;
}

/* Whether tables are those of a loudness meter for so many bins. */
static int is_meter(Table weights, Table edges, Table scale, Table widths, size_t bins)
{
    if (weights.length != bins || edges.length < 2 || edges.at[0] != 0.0)
        return 0;
    for (size_t one = 1; one < edges.length; one++)
        if (!(edges.at[one] > edges.at[one - 1] && edges.at[one] == floor(edges.at[one])))
            return 0;
    return edges.at[edges.length - 1] <= (double)bins && scale.length == edges.length - 1 &&
           widths.length == edges.length - 1;
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
    if (!downmix_is_table(s->mix_weights))
        return "mix_weights: not one layout after another";
    if (!is_share(s->mix_slow) || !is_share(s->mix_newest) || !is_share(s->mix_evidence))
        return "mix_slow, mix_newest, mix_evidence: not from 0 to 1";
    if (!(0.0 <= s->mix_cancels_up_to && s->mix_cancels_up_to < s->mix_cancels_from &&
          s->mix_cancels_from <= 1.0))
        return "mix_cancels_up_to, mix_cancels_from: not ascending from 0 to 1";
    if (!isfinite(s->mix_power_guard))
        return "mix_power_guard: not finite";
    if (s->window_frames < 1 || s->window.length != s->window_frames)
        return "window: not one entry a frame";
    if (s->decimation < 1 || s->steps < 1 || s->hop_frames != s->decimation * s->steps)
        return "hop_frames: not decimation x steps";
    if (s->ticks < 1 || s->tick_steps < 1 || s->steps != s->ticks * s->tick_steps ||
        s->tick_frames != s->decimation * s->tick_steps || s->tick_frames > s->window_frames)
        return "tick_frames: not decimation x tick_steps, steps not ticks x tick_steps, or too long";
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
    if (s->tick_glide.length != s->tick_steps || s->tick_glide_s.length != s->tick_steps)
        return "tick_glide, tick_glide_s: not one entry a step";
    if (s->short_frames < s->tick_frames || s->short_frames > s->window_frames ||
        s->short_window.length != s->short_frames)
        return "short_window: not one entry a frame, under a tick, or longer than the window";
    if (s->short_length < s->short_frames || s->short_length % 2)
        return "short_length: odd, or under short_frames";
    if (s->short_bins < 1 || s->short_bins > s->short_length / 2 + 1 ||
        s->short_hz.length != s->short_bins)
        return "short_hz: not one entry a bin within the spectrum";
    if (!are_edges(s->band_edges, s->short_bins))
        return "band_edges: not ascending within the bins";
    if (s->newest_frames < 1 || s->newest_frames > s->tick_frames)
        return "newest_frames: not within a tick";
    if (s->short_ticks != (s->short_frames + s->tick_frames - 1) / s->tick_frames)
        return "short_ticks: not those that short_frames touch";
    /* An onset is compared with up to three ticks ago; see `rises` in onsets.c. */
    if (s->back_ticks < 3 || s->back_ticks > BACK_MAX)
        return "back_ticks: under 3, or too many";
    if (s->rearmed_ticks < 1 || s->rest_ticks < s->rearmed_ticks)
        return "rearmed_ticks: not from 1 to rest_ticks";
    if (s->heard_ticks < 1 || s->one_tone.length != s->heard_ticks)
        return "one_tone: not one entry for each of heard_ticks";
    if (s->groups_max < 1 || s->groups_max > s->fresh_max || s->fresh_max > FRESH_MAX)
        return "groups_max, fresh_max: none, too many, or more groups than partials";
    if (s->rise_shares.length < 1)
        return "rise_shares: empty";
    if (s->emphasis.length < 1)
        return "emphasis: empty";
    if (s->find_onsets > 1 || s->by_energy > 1)
        return "find_onsets, by_energy: neither 0 nor 1";
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
    if (s->loudness_weights.length &&
        (!is_meter(s->loudness_weights, s->loudness_edges, s->loudness_scale, s->loudness_widths,
                   s->bins) ||
         !is_meter(s->onset_loudness_weights, s->onset_loudness_edges, s->onset_loudness_scale,
                   s->onset_loudness_widths, s->short_bins)))
        return "loudness_weights: neither none nor one a bin, or their bands do not fit";
    if (s->felt_weights.length < 2 || s->onset_felt_squares.length != s->short_bins)
        return "felt_weights: under two entries, or onset_felt_squares not one a short bin";
#define ENTRY(name)                                                                                \
    if (!isfinite(s->name))                                                                        \
        return #name ": not finite";
    FOLLOWER(ENTRY)
#undef ENTRY
    if (!(s->nothing > 0.0))
        return "nothing: not above 0";
    if (!(s->programme_min <= s->programme_start && s->programme_start <= s->programme_top))
        return "programme_start: not from programme_min to programme_top";
    return speech_misfit(s);
}
