/* Speech detection: signs of speech, probability of speech and gain. docs/transform.md describes them. */

#include "speech.h"
#include "exact.h"

#define VOWELS_FIRST 1 /* index of the first octave of vowels */
#define VOWELS 4
#define HISS_FIRST (OCTAVES - 2) /* index of the first octave of fricative consonants */
#define HARDLY_VOICED 1e-3       /* avoids 0 / 0 in the share of voiced hops with a steady pitch */
#define ROOT_MIN 1e-300          /* smallest argument of `fifth_root` */

static double ramp(const Settings *s, int which, double value)
{
    const double *ends = s->speech_ramps.at + 2 * which;
    return clip((value - ends[0]) / (ends[1] - ends[0]), 0.0, 1.0);
}

static size_t pitches(const Settings *s) { return s->speech_log_pitches.length; }

static size_t teeth(const Settings *s) { return s->speech_teeth.length / 2 / pitches(s); }

/* ----------------------------------------------------------------------------------------- pitch */

/* Return the sum of `roots`, interpolated at the bin positions `tooth`. A position of 0 is skipped. */
static double sum_comb(const double *roots, const double *tooth, size_t count)
{
    double sum = 0.0;
    for (size_t one = 0; one < count; one++) {
        if (!(tooth[one] > 0.0))
            continue;
        const size_t below = (size_t)tooth[one];
        sum += roots[below] + (tooth[one] - (double)below) * (roots[below + 1] - roots[below]);
    }
    return sum;
}

/* Return a pitch's contrast, -1 to 1: (a - b) / (a + b + speech_silent_power), where a and b are the sums
 * of `roots` at the harmonics and halfway between them. roots: fifth root of the power of each bin. */
static double contrast(const Settings *s, const double *roots, size_t pitch)
{
    const size_t count = teeth(s);
    const double *harmonics = s->speech_teeth.at + pitch * count;
    const double on = sum_comb(roots, harmonics, count);
    const double between = sum_comb(roots, harmonics + pitches(s) * count, count);
    return (on - between) / (on + between + s->speech_silent_power);
}

/* Find the pitch of highest contrast (of equals, the lowest); return its contrast. power: overwritten.
 * contrasts: work space, one number per pitch. */
static double found_pitch(const Settings *s, double *power, double *contrasts, double *log_pitch)
{
    const size_t bins = (size_t)maximum(s->speech_teeth.at, s->speech_teeth.length) + 2;
    const double even = s->speech_even * maximum(power, bins);
    double highest = -1.0;
    for (size_t bin = 0; bin < bins; bin++)
        power[bin] = fifth_root(larger(power[bin] + even, ROOT_MIN));
    for (size_t pitch = 0; pitch < pitches(s); pitch++) {
        contrasts[pitch] = contrast(s, power, pitch);
        highest = larger(contrasts[pitch], highest);
    }
    size_t best = 0;
    while (best + 1 < pitches(s) && !(contrasts[best] >= highest - s->speech_equal))
        best++;
    const double *logs = s->speech_log_pitches.at, top = contrasts[best];
    *log_pitch = logs[best];
    if (best > 0 && best + 1 < pitches(s)) {
        const double below = contrasts[best - 1], above = contrasts[best + 1];
        const double curved = smaller(below - 2.0 * top + above, -s->speech_flat);
        *log_pitch += clip((below - above) / (2.0 * curved), -0.5, 0.5) * (logs[1] - logs[0]);
    }
    return top;
}

/* ------------------------------------------------------------------------------------------ signs */

static void note_swing(const Settings *s, Speech *speech, const double *levels, double weight)
{
    double swing[OCTAVES], mean = 0.0, against = 0.0;
    for (size_t one = 0; one < OCTAVES; one++) {
        speech->fast[one] += s->speech_fast * (levels[one] - speech->fast[one]);
        speech->slow[one] += s->speech_slow * (levels[one] - speech->slow[one]);
        swing[one] = clip(speech->fast[one] - speech->slow[one], -s->speech_swing_max_db,
                             s->speech_swing_max_db);
    }
    for (size_t one = 0; one < OCTAVES - 1; one++)
        mean += swing[one] / (OCTAVES - 1);
    for (size_t one = 0; one < OCTAVES - 1; one++)
        against += (swing[one] - mean) * (swing[one] - mean) / (OCTAVES - 1);
    const double vowels = swing[OCTAVES - 1] * swing[OCTAVES - 1];
    speech->swing += weight * (vowels - speech->swing);
    speech->balance += weight * (against - speech->balance);
}

static void note_pitch(const Settings *s, Speech *speech, double log_pitch, double weight)
{
    const double change = (log_pitch - speech->log_pitch) / s->speech_steady_pitch;
    speech->log_pitch = log_pitch;
    const double steady = speech->voiced / (1.0 + change * change);
    speech->voicing += weight * (speech->voiced - speech->voicing);
    speech->steady += weight * (steady - speech->steady);
}

static void update_probability(const Settings *s, Speech *speech)
{
    const double resting = speech->steady / (speech->voicing + HARDLY_VOICED);
    const double likely =
        ramp(s, VOICING, speech->voicing) * ramp(s, SWING, sqrt(speech->swing)) *
        ramp(s, BALANCE, sqrt(speech->balance)) * (1.0 - ramp(s, RESTING, resting));
    const double threshold =
        s->speech_likely + (s->speech_likely_still - s->speech_likely) * speech->probability;
    const double speed = clip((likely - threshold) / s->speech_sure, -1.0, 1.0);
    const double step = speed * (speed > 0.0 ? s->speech_attack : s->speech_release);
    speech->probability = clip(speech->probability + step, 0.0, 1.0);
}

/* Update the levels of the voice and of the background. */
static void learn(const Settings *s, Speech *speech)
{
    for (size_t octave = 0; octave < OCTAVES; octave++) {
        const double level = speech->level[octave], voice = speech->loudness[octave];
        const double more = larger(level - voice, 0.0) * (s->speech_learnt * speech->voiced);
        speech->loudness[octave] = larger(voice - s->speech_voice_fall_db, voice + more);
        const double change = level - speech->background[octave];
        speech->background[octave] += change > 0.0 ? smaller(change, s->speech_background_rise_db)
                                                   : s->speech_background_fall * change;
    }
}

static void follow(const Settings *s, Speech *speech, const double *octaves, double log_pitch, int starts)
{
    const double total = sum(octaves, OCTAVES), vowels = sum(octaves + VOWELS_FIRST, VOWELS);
    double levels[OCTAVES];
    speech->peak = larger(total, s->speech_peak_fall * speech->peak);
    const double least = s->speech_unheard * speech->peak + s->speech_silent_power;
    const double least_db = 10.0 * exact_log10(least / s->speech_silent_power);
    for (size_t octave = 0; octave < OCTAVES; octave++) {
        if (starts) /* averages, voice and background start at the lowest level, as after silence */
            speech->fast[octave] = speech->slow[octave] = speech->loudness[octave] =
                speech->background[octave] = least_db;
        speech->level[octave] = 10.0 * exact_log10((octaves[octave] + least) / s->speech_silent_power);
    }
    memcpy(levels, speech->level + 1, (OCTAVES - 1) * sizeof(double));
    levels[OCTAVES - 1] = 10.0 * exact_log10((vowels + least) / s->speech_silent_power);
    const double loudness = 10.0 * exact_log10((total + least) / (speech->peak + least));
    const double weight = ramp(s, QUIET, loudness);
    note_swing(s, speech, levels, s->speech_average * larger(weight, s->speech_quiet_share));
    note_pitch(s, speech, log_pitch, s->speech_average * weight);
    update_probability(s, speech);
    learn(s, speech);
}

void speech_update(const Settings *s, Speech *speech, const double *real, const double *imaginary,
                 double *work)
{
    double octaves[OCTAVES], log_pitch;
    for (size_t bin = 0; bin < s->bins; bin++)
        work[bin] = real[bin] * real[bin] + imaginary[bin] * imaginary[bin];
    for (size_t octave = 0; octave < OCTAVES; octave++) {
        const size_t first = (size_t)s->speech_edges.at[octave], end = (size_t)s->speech_edges.at[octave + 1];
        octaves[octave] = sum(work + first, end - first);
    }
    speech->voiced = ramp(s, VOICED, found_pitch(s, work, work + s->bins, &log_pitch));
    const int starts = speech_is_at_rest(speech);
    speech->hops_to_rest = s->speech_rest_hops;
    follow(s, speech, octaves, log_pitch, starts);
}

void speech_pause(const Settings *s, Speech *speech)
{
    static const double NOTHING[OCTAVES] = {0.0};
    if (speech_is_at_rest(speech))
        return;
    speech->hops_to_rest -= 1.0;
    if (speech_is_at_rest(speech)) {
        memset(speech, 0, sizeof *speech);
        return;
    }
    speech->voiced = 0.0;
    follow(s, speech, NOTHING, speech->log_pitch, 0);
}

/* ------------------------------------------------------------------------------------------ gain */

/* Return the share of a partial that can be voice, 0 to 1, interpolated between the two nearest octaves. */
static double spoken_share(const Settings *s, const Speech *speech, double audio_hz)
{
    double spoken[OCTAVES], over_db[OCTAVES], loudest = speech->loudness[0], most = -INFINITY;
    for (size_t octave = 1; octave < OCTAVES; octave++)
        loudest = larger(speech->loudness[octave], loudest);
    for (size_t octave = 0; octave < OCTAVES; octave++) {
        const double limit = octave < HISS_FIRST ? speech->loudness[octave] : loudest;
        over_db[octave] = speech->level[octave] - limit;
        most = larger(over_db[octave], most);
    }
    const double hidden = (1.0 - speech->voiced) * ramp(s, EXCESS, most);
    for (size_t octave = 0; octave < OCTAVES; octave++) {
        const double clear_db = s->speech_clear_db * speech->voiced;
        const double excess = larger(ramp(s, EXCESS, over_db[octave] - clear_db), hidden);
        const double above = speech->level[octave] - speech->background[octave];
        spoken[octave] = (1.0 - excess) * ramp(s, BACKGROUND, above);
    }
    const double *centres = s->speech_centres_hz.at;
    size_t above = 0;
    while (above < OCTAVES && !(centres[above] > audio_hz))
        above++;
    double share = spoken[above < OCTAVES ? above : OCTAVES - 1];
    if (above > 0 && above < OCTAVES) {
        const double place = (audio_hz - centres[above - 1]) / (centres[above] - centres[above - 1]);
        share = spoken[above - 1] + place * (spoken[above] - spoken[above - 1]);
    }
    return share * ramp(s, SPARED, audio_hz);
}

static double lower_gain(const Settings *s, const Speech *speech, double share)
{
    return exact_amplitude(-s->speech_db * speech->probability * share);
}

double speech_coarse_gain(const Settings *s, const Speech *speech, double audio_hz)
{
    return lower_gain(s, speech, spoken_share(s, speech, audio_hz));
}

double speech_gain(const Settings *s, const Speech *speech, double audio_hz)
{
    const double harmonic = audio_hz / exact_exp(speech->log_pitch);
    const double apart = fabs(harmonic - rint(harmonic)) - s->speech_apart * harmonic;
    const double on_harmonic = 1.0 - speech->voiced * ramp(s, BETWEEN, apart);
    return lower_gain(s, speech, spoken_share(s, speech, audio_hz) * on_harmonic);
}
