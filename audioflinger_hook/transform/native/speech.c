/* Speech heard in the sound: the cues, the probability and the gain. docs/transform.md says what each is
 * for. */

#include "speech.h"

#include "exact.h"

/* The vowels' octaves, of which the level is taken. */
#define VOWELS_FIRST 1
#define VOWELS_END 5

/* Consonants hiss in these. */
#define HISS_FIRST (OCTAVES - 2)

/* Keeps the share of voiced hops that have a steady pitch off 0 / 0. */
#define HARDLY_VOICED 1e-3

/* The least number of which `fifth_root` is one. */
#define ROOT_MIN 1e-300

/* In the order in which speech_ramps has them. */
enum { VOICED, QUIET, VOICING, SWING, BALANCE, RESTING, SPARED, EXCESS, BACKGROUND, BETWEEN, RAMPS };

static double ramp(const Settings *s, int which, double value)
{
    const double *ends = s->speech_ramps.at + 2 * which;
    return clip((value - ends[0]) / (ends[1] - ends[0]), 0.0, 1.0);
}

static size_t pitches(const Settings *s) { return s->speech_log_pitches.length; }

static size_t teeth(const Settings *s) { return s->speech_teeth.length / 2 / pitches(s); }

const char *speech_misfit(const Settings *s)
{
    if (s->speech_edges.length != OCTAVES + 1 || s->speech_centres_hz.length != OCTAVES)
        return "speech_edges, speech_centres_hz: not of so many octaves";
    for (size_t edge = 0; edge <= OCTAVES; edge++) {
        const double bin = s->speech_edges.at[edge];
        if (!(bin >= (edge ? s->speech_edges.at[edge - 1] : 0.0) && bin <= (double)s->bins))
            return "speech_edges: not ascending within the bins";
    }
    for (size_t octave = 1; octave < OCTAVES; octave++)
        if (!(s->speech_centres_hz.at[octave] > s->speech_centres_hz.at[octave - 1]))
            return "speech_centres_hz: not ascending";
    if (pitches(s) < 2 || !s->speech_teeth.length || s->speech_teeth.length % (2 * pitches(s)))
        return "speech_log_pitches, speech_teeth: not two combs a pitch";
    for (size_t tooth = 0; tooth < s->speech_teeth.length; tooth++)
        if (!(s->speech_teeth.at[tooth] >= 0.0 &&
              s->speech_teeth.at[tooth] <= (double)s->bins - 2.0))
            return "speech_teeth: not within the bins";
    if (s->speech_ramps.length != 2 * RAMPS)
        return "speech_ramps: not so many";
    return NULL;
}

/* ----------------------------------------------------------------------------------------- pitch */

/* What stands at a comb's teeth, on lines between bins. */
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

/* How far a pitch's harmonics stand out of the valleys between. */
static double contrast(const Settings *s, const double *roots, size_t pitch)
{
    const size_t count = teeth(s);
    const double *harmonics = s->speech_teeth.at + pitch * count;
    const double on = sum_comb(roots, harmonics, count);
    const double between = sum_comb(roots, harmonics + pitches(s) * count, count);
    return (on - between) / (on + between + s->speech_silent_power);
}

/* Find the pitch; its contrast is returned. power: overwritten. contrasts: room for one a pitch. */
static double found_pitch(const Settings *s, double *power, double *contrasts, double *log_pitch)
{
    double last = 0.0, highest = -1.0;
    for (size_t tooth = 0; tooth < s->speech_teeth.length; tooth++)
        last = larger(s->speech_teeth.at[tooth], last);
    double even = 0.0;
    for (size_t bin = 0; bin < (size_t)last + 2; bin++)
        even = larger(power[bin], even);
    even *= s->speech_even;
    for (size_t bin = 0; bin < (size_t)last + 2; bin++)
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

/* ------------------------------------------------------------------------------------------ cues */

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

/* Learn how loud the voice and what is behind it are. */
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

/* Begin as if there had been silence before, so far down that the volume does not matter. */
static void start(Speech *speech, double least_db)
{
    for (size_t octave = 0; octave < OCTAVES; octave++) {
        speech->fast[octave] = speech->slow[octave] = least_db;
        speech->loudness[octave] = speech->background[octave] = least_db;
    }
}

static void follow(const Settings *s, Speech *speech, const double *octaves, double log_pitch,
                   int starts)
{
    double total = 0.0, vowels = 0.0, levels[OCTAVES];
    for (size_t octave = 0; octave < OCTAVES; octave++)
        total += octaves[octave];
    for (size_t octave = VOWELS_FIRST; octave < VOWELS_END; octave++)
        vowels += octaves[octave];
    speech->peak = larger(total, s->speech_peak_fall * speech->peak);
    const double least = s->speech_unheard * speech->peak + s->speech_silent_power;
    if (starts)
        start(speech, 10.0 * exact_log10(least / s->speech_silent_power));
    for (size_t octave = 0; octave < OCTAVES; octave++)
        speech->level[octave] =
            10.0 * exact_log10((octaves[octave] + least) / s->speech_silent_power);
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
        octaves[octave] = 0.0;
        const size_t end = (size_t)s->speech_edges.at[octave + 1];
        for (size_t bin = (size_t)s->speech_edges.at[octave]; bin < end; bin++)
            octaves[octave] += work[bin];
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

/* How much of a partial can be the voice's, by where it stands alone. */
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
