/* The live form's memory: where everything of a stream lies, and what its state may be. */

#include "live.h"

#include "common.h"

#define SLOT_NUMBERS 11
#define FRESH_NUMBERS (sizeof(OnsetPartial) / sizeof(double))
#define GLIDE_NUMBERS 5
#define FOUND_NUMBERS 4

/* Take the next numbers of the state, which is one piece, so that it can be kept and returned to. */
static double *next_state(double **next, size_t count)
{
    double *here = *next;
    *next += count;
    return here;
}

static double *numbers(Arena *arena, size_t count)
{
    return arena_alloc(arena, count, sizeof(double));
}

static size_t onset_numbers(const Settings *s)
{
    const size_t bands = onsets_bands(s);
    return s->short_ticks + (s->back_ticks + 2) * bands + s->short_bins + 3;
}

static size_t older_powers(const Settings *s) { return (s->average_ticks - 1) * band_powers_high(s); }

/* What is remembered only where loudness is followed. */
static size_t followed_numbers(const Settings *s)
{
    return LOW_STATES + older_powers(s) + STRENGTH_STATES + DRIVE_STATES + GLIDE_NUMBERS * tracking_slots(s);
}

static size_t voice_numbers(const Settings *s)
{
    return s->band_b.length - 1 + s->window_frames + s->hops_in_window + s->tick_frames +
           onset_numbers(s) + FRESH_NUMBERS * s->fresh_max + SLOT_NUMBERS * tracking_slots(s) +
           SPEECH_STATES + smoothing_states(s) + smoothing_tail(s) + 3 +
           (loudness_is_on(s) ? followed_numbers(s) : s->steps);
}

static void layout_followed(const Settings *s, Voice *voice, double **next)
{
    Glides *hop = &voice->oscillators.hop;
    double **of_hop[GLIDE_NUMBERS] = {&hop->start_hz, &hop->end_hz, &hop->start_amplitude,
                                      &hop->end_amplitude, &hop->start_phase};
    voice->powers.low = (LowBands *)next_state(next, LOW_STATES);
    voice->powers.recent = next_state(next, older_powers(s));
    voice->strength = (Strength *)next_state(next, STRENGTH_STATES);
    voice->oscillators.drive = (Drive *)next_state(next, DRIVE_STATES);
    for (size_t which = 0; which < GLIDE_NUMBERS; which++)
        *of_hop[which] = next_state(next, tracking_slots(s));
}

static void layout_voice(const Settings *s, Voice *voice, double **next)
{
    const size_t slots = tracking_slots(s), bands = onsets_bands(s);
    voice->band = next_state(next, s->band_b.length - 1);
    voice->past = next_state(next, s->window_frames);
    voice->peaks = next_state(next, s->hops_in_window);
    voice->played = next_state(next, s->tick_frames);
    voice->onsets.peaks = next_state(next, s->short_ticks);
    voice->onsets.past = next_state(next, s->back_ticks * bands);
    voice->onsets.highest = next_state(next, bands);
    voice->onsets.rising = next_state(next, bands);
    voice->onsets.power = next_state(next, s->short_bins);
    voice->onsets.since = next_state(next, 1);
    voice->onsets.newest = next_state(next, 1);
    voice->onsets.peak = next_state(next, 1);
    voice->fresh = (OnsetPartial *)next_state(next, FRESH_NUMBERS * s->fresh_max);
    double **of_slots[SLOT_NUMBERS] = {
        &voice->slots.hz,            &voice->slots.amplitude,  &voice->slots.phase,
        &voice->slots.alive,         &voice->slots.held_first, &voice->slots.held_last,
        &voice->slots.held_loudness, &voice->slots.held_hops,  &voice->slots.held_amplitude,
        &voice->slots.held_weight,   &voice->slots.lacking,
    };
    for (size_t which = 0; which < SLOT_NUMBERS; which++)
        *of_slots[which] = next_state(next, slots);
    voice->slots.start_sum = next_state(next, 1);
    voice->begun = next_state(next, 1);
    voice->smoothing.state = next_state(next, smoothing_states(s));
    voice->smoothing.tail = next_state(next, smoothing_tail(s));
    voice->ringing = next_state(next, 1);
    voice->speech = (Speech *)next_state(next, SPEECH_STATES);
    if (loudness_is_on(s))
        layout_followed(s, voice, next);
    else
        voice->hop = next_state(next, s->steps);
}

/* Lay out the work space. */
static void layout_work(Live *live, Arena *arena)
{
    const Settings *s = &live->settings;
    const size_t slots = tracking_slots(s);
    live->mono = numbers(arena, s->tick_frames);
    live->side = numbers(arena, s->tick_frames);
    live->newest = numbers(arena, s->short_frames);
    live->onset_space = numbers(arena, onsets_work(s, &live->short_fft));
    live->windowed = numbers(arena, live->fft.frames);
    live->real = numbers(arena, s->bins);
    live->imaginary = numbers(arena, s->bins);
    live->fft_space = numbers(arena, fft_work(&live->fft));
    live->tracking_space = arena_alloc(arena, tracking_work(s), 1);
    live->synthesis_space = numbers(arena, synthesis_work(s));
    live->low_rate = numbers(arena, s->tick_steps);
    live->oscillator_space = numbers(arena, oscillators_work(s));
    live->speech_space = numbers(arena, speech_work(s));
    live->analysis_space = arena_alloc(arena, analysis_work(s->bins), 1);
    double **found[FOUND_NUMBERS] = {&live->found.audio_hz, &live->found.amplitude,
                                     &live->found.bandwidth_hz, &live->found.r};
    for (size_t which = 0; which < FOUND_NUMBERS; which++)
        *found[which] = numbers(arena, s->partials_max);
    live->hz = numbers(arena, s->partials_max);
    live->amplitude = numbers(arena, s->partials_max);
    double **glides[GLIDE_NUMBERS] = {&live->glides.start_hz, &live->glides.end_hz,
                                      &live->glides.start_amplitude, &live->glides.end_amplitude,
                                      &live->glides.start_phase};
    for (size_t which = 0; which < GLIDE_NUMBERS; which++)
        *glides[which] = numbers(arena, slots);
    double **fresh[GLIDE_NUMBERS] = {
        &live->fresh_glides.start_hz,      &live->fresh_glides.end_hz,
        &live->fresh_glides.start_amplitude, &live->fresh_glides.end_amplitude,
        &live->fresh_glides.start_phase,
    };
    for (size_t which = 0; which < GLIDE_NUMBERS; which++)
        *fresh[which] = numbers(arena, s->fresh_max);
}

int live_open(Live *live, const Settings *settings, size_t channels, int each, Arena *arena)
{
    memset(live, 0, sizeof *live);
    live->settings = *settings;
    live->channels = channels;
    live->each = each;
    live->voices_count = each ? channels : 1;
    live->mix_weights = each ? NULL : downmix_weights(&live->settings, channels);
    live->state_length = live->voices_count * voice_numbers(settings) + MIX_POWERS;
    if (!fft_open(&live->fft, settings->fft_length, 1, arena) ||
        !fft_open(&live->short_fft, settings->short_length, 0, arena))
        return 0;
    live->voices = arena_alloc(arena, live->voices_count, sizeof(Voice));
    live->state = numbers(arena, live->state_length);
    layout_work(live, arena);
    if (!live->state)
        return 1;
    double *next = live->state;
    for (size_t voice = 0; voice < live->voices_count; voice++)
        layout_voice(settings, &live->voices[voice], &next);
    live->mix_powers = (MixPowers *)next_state(&next, MIX_POWERS);
    live_reset(live);
    return 1;
}

void live_reset(Live *live)
{
    memset(live->state, 0, live->state_length * sizeof(double));
    live->filled = live->tick = live->oldest = 0;
    live->told.count = 0;
    live->silent = live->settings.window_frames; /* before the beginning there was nothing */
    for (size_t voice = 0; voice < live->voices_count; voice++) {
        onsets_reset(&live->settings, &live->voices[voice].onsets);
        if (loudness_is_on(&live->settings))
            strength_reset(&live->settings, live->voices[voice].strength);
        live_rest(live, &live->voices[voice]);
    }
}

void live_rest(Live *live, Voice *voice)
{
    const Settings *s = &live->settings;
    if (!loudness_is_on(s))
        return;
    band_powers_reset(s, &voice->powers);
    strength_rest(s, voice->strength);
    *voice->oscillators.drive = (Drive){.beat = 1.0};
}

/* Whether a number is within a range and whole. */
static int is_count(double number, double least, double most)
{
    return number >= least && number <= most && number == floor(number);
}

static int are_bands(const Settings *s, double first, double last)
{
    return is_count(first, 0.0, (double)onsets_bands(s)) &&
           is_count(last, 0.0, (double)onsets_bands(s));
}

static int voice_is_possible(const Settings *s, const Voice *voice)
{
    size_t alive = 0;
    for (size_t slot = 0; slot < tracking_slots(s); slot++) {
        alive += voice->slots.alive[slot] != 0.0;
        if (!are_bands(s, voice->slots.held_first[slot], voice->slots.held_last[slot]) ||
            !is_count(voice->slots.held_hops[slot], 0.0, (double)s->hold_hops + 1.0))
            return 0;
    }
    const double oldest = (double)s->heard_ticks + (double)s->rise_shares.length;
    for (size_t slot = 0; slot < s->fresh_max; slot++)
        if (!are_bands(s, voice->fresh[slot].first_band, voice->fresh[slot].last_band) ||
            !is_count(voice->fresh[slot].age, 0.0, oldest))
            return 0;
    return alive <= s->partials_max + s->fresh_max &&
           is_count(*voice->onsets.since, 0.0, (double)(s->rest_ticks + s->heard_ticks)) &&
           *voice->ringing >= 0.0 && *voice->ringing <= (double)s->ring_hops &&
           is_count(*voice->begun, 0.0, (double)(s->begin_frames + s->begin_fade.length)) &&
           (!loudness_is_on(s) || (strength_is_possible(s, voice->strength) &&
                                   oscillators_are_possible(s, voice->oscillators.drive)));
}

int live_state_is_valid(const Live *live)
{
    const Settings *s = &live->settings;
    if (live->filled >= s->tick_frames || live->tick >= s->ticks ||
        live->oldest >= s->window_frames || live->silent > s->window_frames ||
        !downmix_is_possible(live->mix_powers))
        return 0;
    for (size_t which = 0; which < live->voices_count; which++)
        if (!voice_is_possible(s, &live->voices[which]))
            return 0;
    return 1;
}
