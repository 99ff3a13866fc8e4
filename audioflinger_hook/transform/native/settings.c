/* Whether settings fit one another: whatever they are, nothing behind them is read or written. */

#include "settings.h"

#include "analysis.h"
#include "downmix.h"
#include "filter.h"
#include "loudness.h"
#include "speech.h"

/* Three times the longest spectrum that there is: no sum or product of such sizes overflows. */
#define COUNT_MAX ((size_t)1 << 20)

/* The largest average_ticks. */
#define AVERAGE_MAX 64

static int is_recursion(Table b, Table a)
{
    return b.length == a.length && b.length >= 2 && b.length <= ORDER_MAX + 1 && a.at[0] == 1.0;
}

static int is_share(double number) { return number >= 0.0 && number <= 1.0; }

/* Whole numbers from `least` to `most`, each more than the last. */
static int ascend(Table edges, double least, size_t most)
{
    for (size_t one = 0; one < edges.length; one++) {
        const double edge = edges.at[one];
        if (!(edge >= least && edge <= (double)most && edge == floor(edge)))
            return 0;
        least = edge + 1.0;
    }
    return 1;
}

/* What of the tables by which loudness is followed does not fit; NULL where all does. */
static const char *loudness_misfit(const Settings *s)
{
    const size_t bands = s->loudness_scale.length, high = s->high_weights.length;
    const size_t low = s->low_weights.length, groups = s->loudness_groups.length;
    if (bands > BANDS_MAX || s->loudness_widths.length != bands || high > bands)
        return "loudness_scale, loudness_widths: not one a band, or too many";
    if (s->low_poles.length != LOW_NUMBERS * low || s->low_band_of.length != low || low > LOW_MAX)
        return "low_poles, low_weights, low_band_of: not of the same bands, or too many";
    for (size_t one = 0; one < low; one++)
        if (!(s->low_band_of.at[one] >= 0.0 && s->low_band_of.at[one] < (double)bands))
            return "low_band_of: a band that is not there";
    if (s->high_edges.length != (high ? high + 1 : 0) || !ascend(s->high_edges, 0.0, s->short_bins))
        return "high_edges: not one more than bands, or not ascending within the bins";
    if (s->low_smooth.length % SECTION_NUMBERS || s->low_smooth.length / SECTION_NUMBERS > SECTIONS_MAX ||
        s->quadrature.length != 2 * CHAIN)
        return "low_smooth, quadrature: not sections, or not of two chains";
    if (groups < 2 || groups > GROUPS_OF_BANDS_MAX + 1 || s->loudness_groups.at[0] != 0.0 ||
        !ascend(s->loudness_groups, 0.0, bands) || s->loudness_groups.at[groups - 1] != (double)bands)
        return "loudness_groups: not ascending from the first band to the last";
    if (s->average_ticks < 1 || s->average_ticks > AVERAGE_MAX)
        return "average_ticks: none, or too many";
    if (!(s->boost_max >= 0.0 && s->concentrated >= 0.0 && s->beat_least > 0.0 && s->beat_width_hz > 0.0 &&
          s->weakest_step > 0.0 && s->gain_max >= 0.0 && s->start_weight > 0.0))
        return "boost_max, concentrated, beat_least, weakest_step, gain_max: negative, or 0";
    return NULL;
}

const char *settings_error(const Settings *s)
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
    if (s->name.length > COUNT_MAX || !table_is_finite(s->name))                                      \
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
    if (!is_recursion(s->band_b, s->band_a) ||
        (!s->low_sections.length && !is_recursion(s->low_b, s->low_a)))
        return "band_b, band_a, low_b, low_a: not as long as one another, or not to 1";
    if (s->low_sections.length % SECTION_NUMBERS || s->low_sections.length / SECTION_NUMBERS > SECTIONS_MAX)
        return "low_sections: not sections, or too many";
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
    if (s->band_edges.length < 2 || !ascend(s->band_edges, 1.0, s->short_bins))
        return "band_edges: not ascending within the bins";
    if (s->newest_frames < 1 || s->newest_frames > s->tick_frames)
        return "newest_frames: not within a tick";
    if (s->short_ticks != (s->short_frames + s->tick_frames - 1) / s->tick_frames)
        return "short_ticks: not those that short_frames touch";
    /* An onset is compared with up to three ticks ago; see `detect` in onsets.c. */
    if (s->back_ticks < 3 || s->back_ticks > BACK_MAX)
        return "back_ticks: under 3, or too many";
    if (s->rearmed_ticks < 1 || s->rest_ticks < s->rearmed_ticks)
        return "rearmed_ticks: not from 1 to rest_ticks";
    if (s->heard_ticks < 1 || s->one_tone.length != s->heard_ticks)
        return "one_tone: not one entry for each of heard_ticks";
    if (s->groups_max < 1 || s->groups_max > s->onset_partials_max || s->onset_partials_max > FRESH_MAX)
        return "groups_max, onset_partials_max: none, too many, or more groups than partials";
    if (s->rise_shares.length < 1)
        return "rise_shares: empty";
    if (s->find_onsets > 1 || s->energy_mapping > 1)
        return "find_onsets, energy_mapping: neither 0 nor 1";
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
    if (s->felt_weights.length < 2)
        return "felt_weights: under two entries";
#define ENTRY(name)                                                                                \
    if (!isfinite(s->name))                                                                        \
        return #name ": not finite";
    FOLLOWER(ENTRY)
#undef ENTRY
    if (!(s->nothing > 0.0))
        return "nothing: not above 0";
    if (!(s->programme_min <= s->programme_start && s->programme_start <= s->programme_top))
        return "programme_start: not from programme_min to programme_top";
    const char *misfit = s->loudness_scale.length ? loudness_misfit(s) : NULL;
    return misfit ? misfit : speech_misfit(s);
}
