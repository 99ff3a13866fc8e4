#include "settings.h"
#include "analysis.h"
#include "filter.h"
#include "loudness.h"
#include "speech.h"

#define COUNT_MAX ((size_t)1 << 20) /* largest allowed count; prevents overflow of sums and products */
#define AVERAGE_MAX 64              /* largest allowed average_ticks */

static int is_recursion(Table b, Table a)
{
    return b.length == a.length && is_within(b.length, 2, ORDER_MAX + 1) && a.at[0] == 1.0;
}

static int are_sections(Table table)
{
    return table.length % SECTION_NUMBERS == 0 && table.length / SECTION_NUMBERS <= SECTIONS_MAX;
}

static int is_share(double number) { return number >= 0.0 && number <= 1.0; }

static int are_within(Table table, double least, double most)
{
    for (size_t one = 0; one < table.length; one++)
        if (!(table.at[one] >= least && table.at[one] <= most))
            return 0;
    return 1;
}

/* Return whether edges are strictly ascending integers from `least` to `most`. */
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

/* Return whether a table consists of channel layouts, each a number of channels and two rows of weights. */
static int are_layouts(Table table)
{
    for (size_t at = 0; at < table.length;) {
        const double count = table.at[at], room = (double)(table.length - at - 1) / 2.0;
        if (!(count >= 1.0 && count <= room && count == floor(count)))
            return 0;
        at += 1 + 2 * (size_t)count;
    }
    return 1;
}

static const char *loudness_misfit(const Settings *s)
{
    const size_t bands = s->loudness_scale.length, groups = s->loudness_groups.length;
    REQUIRE(bands <= BANDS_MAX && s->high_weights.length <= bands && s->low_weights.length <= LOW_MAX,
            "loudness_scale, low_weights, high_weights: too many bands");
    REQUIRE(are_within(s->low_band_of, 0.0, (double)bands - 1.0), "low_band_of: a band that is not there");
    REQUIRE(ascend(s->high_edges, 0.0, s->short_bins), "high_edges: not ascending within the bins");
    REQUIRE(s->low_smooth.length == (s->decimation + SMOOTH_STATES) * SMOOTH_ROW,
            "low_smooth: not a row for each frame and state");
    REQUIRE(is_within(groups, 2, GROUPS_OF_BANDS_MAX + 1) && s->loudness_groups.at[0] == 0.0 &&
                ascend(s->loudness_groups, 0.0, bands) && s->loudness_groups.at[groups - 1] == (double)bands,
            "loudness_groups: not ascending from the first band to the last");
    REQUIRE(is_within(s->average_ticks, 1, AVERAGE_MAX), "average_ticks: none, or too many");
    REQUIRE(s->boost_max >= 0.0 && s->concentrated >= 0.0 && s->beat_least > 0.0 && s->beat_width_hz > 0.0 &&
                s->weakest_step > 0.0 && s->gain_max >= 0.0 && s->start_weight > 0.0 && s->group_sone > 0.0,
            "boost_max, concentrated, beat_least, weakest_step, gain_max, group_sone: negative, or 0");
    return NULL;
}

static const char *speech_misfit(const Settings *s)
{
    const size_t pitches = s->speech_log_pitches.length, teeth = s->speech_teeth.length;
    const double *edges = s->speech_edges.at, *centres_hz = s->speech_centres_hz.at;
    for (size_t octave = 0; octave < OCTAVES; octave++)
        REQUIRE(edges[octave + 1] >= edges[octave], "speech_edges: not ascending");
    for (size_t octave = 1; octave < OCTAVES; octave++)
        REQUIRE(centres_hz[octave] > centres_hz[octave - 1], "speech_centres_hz: not ascending");
    REQUIRE(pitches >= 2 && teeth && teeth % (2 * pitches) == 0,
            "speech_log_pitches, speech_teeth: not two combs a pitch");
    REQUIRE(are_within(s->speech_edges, 0.0, (double)s->bins) &&
                are_within(s->speech_teeth, 0.0, (double)s->bins - 2.0),
            "speech_edges, speech_teeth: not within the bins");
    return NULL;
}

static const char *misfit_of(const Settings *s)
{
    REQUIRE(are_layouts(s->mix_weights), "mix_weights: not one layout after another");
    REQUIRE(is_share(s->mix_slow) && is_share(s->mix_newest) && is_share(s->mix_evidence),
            "mix_slow, mix_newest, mix_evidence: not from 0 to 1");
    REQUIRE(0.0 <= s->mix_cancels_up_to && s->mix_cancels_up_to < s->mix_cancels_from &&
                s->mix_cancels_from <= 1.0,
            "mix_cancels_up_to, mix_cancels_from: not ascending from 0 to 1");
    REQUIRE(isfinite(s->mix_power_guard), "mix_power_guard: not finite");
    REQUIRE(s->window_frames && s->hops_in_window && s->partials_max && s->rise_shares.length &&
                s->image_table.length,
            "window_frames, hops_in_window, partials_max, rise_shares, image_table: under 1");
    REQUIRE(s->decimation && s->steps && s->hop_frames == s->decimation * s->steps,
            "hop_frames: not decimation x steps");
    REQUIRE(s->ticks && s->tick_steps && s->steps == s->ticks * s->tick_steps &&
                s->tick_frames == s->decimation * s->tick_steps && s->tick_frames <= s->window_frames,
            "tick_frames: not decimation x tick_steps, steps not ticks x tick_steps, or too long");
    REQUIRE(s->fft_length / 2 >= s->window_frames, "fft_length: under two windows");
    REQUIRE(is_within(s->bins, 2, s->fft_length / 2 + 1), "bins: not within the spectrum");
    REQUIRE(s->first_bin && (s->last_bin < s->first_bin || s->last_bin <= s->bins - 2),
            "first_bin, last_bin: without a bin to either side");
    REQUIRE(is_recursion(s->band_b, s->band_a) && (s->low_sections.length || is_recursion(s->low_b, s->low_a)),
            "band_b, band_a, low_b, low_a: not as long as one another, or not to 1");
    REQUIRE(are_sections(s->low_sections), "low_sections: not sections, or too many");
    REQUIRE(is_within(s->short_frames, s->tick_frames, s->window_frames),
            "short_frames: under a tick, or longer than the window");
    REQUIRE(s->short_length >= s->short_frames && s->short_length % 2 == 0,
            "short_length: odd, or under short_frames");
    REQUIRE(is_within(s->short_bins, 1, s->short_length / 2 + 1), "short_bins: not within the spectrum");
    REQUIRE(s->band_edges.length >= 2 && ascend(s->band_edges, 1.0, s->short_bins),
            "band_edges: not ascending within the bins");
    REQUIRE(is_within(s->newest_frames, 1, s->tick_frames), "newest_frames: not within a tick");
    REQUIRE(s->short_ticks == (s->short_frames + s->tick_frames - 1) / s->tick_frames,
            "short_ticks: not those that short_frames touch");
    /* `detect` in onsets.c reads the second or third newest row of Onsets.past. */
    REQUIRE(is_within(s->back_ticks, 3, BACK_MAX), "back_ticks: under 3, or too many");
    REQUIRE(s->heard_ticks && is_within(s->rearmed_ticks, 1, s->rest_ticks),
            "heard_ticks: none, or rearmed_ticks: not from 1 to rest_ticks");
    REQUIRE(is_within(s->groups_max, 1, s->onset_partials_max) && s->onset_partials_max <= FRESH_MAX,
            "groups_max, onset_partials_max: none, too many, or more groups than partials");
    REQUIRE(s->find_onsets <= 1 && s->energy_mapping <= 1, "find_onsets, energy_mapping: neither 0 nor 1");
    REQUIRE(s->image_turn.length % 2 == 0 && s->image_turn.length / 2 <= s->bins,
            "image_turn: not two rows within the bins");
    REQUIRE(s->phases.length >= s->decimation && s->phases.length % s->decimation == 0,
            "phases: not rows of decimation");
    REQUIRE(s->gain_table.length >= 2 && s->felt_weights.length >= 2 && s->gain_step_hz > 0.0,
            "gain_table, felt_weights: under two entries, or gain_step_hz not above 0");
    REQUIRE(s->nothing > 0.0, "nothing: not above 0");
    REQUIRE(s->programme_min <= s->programme_start && s->programme_start <= s->programme_top,
            "programme_start: not from programme_min to programme_top");
    const char *misfit = s->loudness_scale.length ? loudness_misfit(s) : NULL;
    return misfit ? misfit : speech_misfit(s);
}

#define CHECK(name, is_right, wrong) REQUIRE(is_right, #name ": " wrong);
#define READ(kind, name)                                                                           \
    REQUIRE(record_##kind(records, #name, &s->name), "it lacks the " #kind " " #name);
#define READ_COUNT(name) READ(count, name) CHECK(name, s->name <= COUNT_MAX, "too large")
#define READ_NUMBER(name) READ(number, name) CHECK(name, !isnan(s->name), "not a number")
#define READ_TABLE(name, ...)                                                                      \
    READ(table, name)                                                                              \
    CHECK(name, s->name.length <= COUNT_MAX && table_is_finite(s->name), "too long, or not finite")
#define CHECK_LENGTH(name, size) CHECK(name, s->name.length == (size), "too short or too long")
#define CHECK_FINITE(name) CHECK(name, isfinite(s->name), "not finite")

const char *settings_read(Settings *s, Records records)
{
    COUNTS(READ_COUNT)
    NUMBERS(READ_NUMBER)
    FREE_TABLES(READ_TABLE)
    SIZED_TABLES(READ_TABLE)
    SIZED_TABLES(CHECK_LENGTH)
    STRENGTH_NUMBERS(CHECK_FINITE)
    return misfit_of(s);
}
