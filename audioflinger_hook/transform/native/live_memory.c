/* The live form's memory: where everything of a stream lies, and what its state may be. */

#include "live.h"

#define SLOT_NUMBERS 11
#define ONSET_PARTIAL_NUMBERS (sizeof(OnsetPartial) / sizeof(double))
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

static size_t older_powers(const Settings *s) { return (s->average_ticks - 1) * s->high_weights.length; }

/* What is remembered only where loudness is followed. */
static size_t followed_numbers(const Settings *s)
{
    return LOW_STATES + older_powers(s) + STRENGTH_STATES + DRIVE_STATES + GLIDE_NUMBERS * tracking_slots(s);
}

static size_t channel_numbers(const Settings *s)
{
    return s->band_b.length - 1 + s->window_frames + s->hops_in_window + s->tick_frames +
           onset_numbers(s) + ONSET_PARTIAL_NUMBERS * s->onset_partials_max +
           SLOT_NUMBERS * tracking_slots(s) + SPEECH_STATES + smoothing_states(s) + smoothing_tail(s) + 3 +
           (loudness_is_on(s) ? followed_numbers(s) : s->steps);
}

static void layout_followed(const Settings *s, Channel *channel, double **next)
{
    Glides *hop = &channel->oscillators.hop;
    double **of_hop[GLIDE_NUMBERS] = {&hop->start_hz, &hop->end_hz, &hop->start_amplitude,
                                      &hop->end_amplitude, &hop->start_phase};
    channel->powers.low = (LowBands *)next_state(next, LOW_STATES);
    channel->powers.recent = next_state(next, older_powers(s));
    channel->strength = (Strength *)next_state(next, STRENGTH_STATES);
    channel->oscillators.drive = (Drive *)next_state(next, DRIVE_STATES);
    for (size_t which = 0; which < GLIDE_NUMBERS; which++)
        *of_hop[which] = next_state(next, tracking_slots(s));
}

static void layout_channel(const Settings *s, Channel *channel, double **next)
{
    const size_t slots = tracking_slots(s), bands = onsets_bands(s);
    channel->band = next_state(next, s->band_b.length - 1);
    channel->past = next_state(next, s->window_frames);
    channel->peaks = next_state(next, s->hops_in_window);
    channel->output_tick = next_state(next, s->tick_frames);
    channel->onsets.peaks = next_state(next, s->short_ticks);
    channel->onsets.past = next_state(next, s->back_ticks * bands);
    channel->onsets.highest = next_state(next, bands);
    channel->onsets.rising = next_state(next, bands);
    channel->onsets.power = next_state(next, s->short_bins);
    channel->onsets.since = next_state(next, 1);
    channel->onsets.newest = next_state(next, 1);
    channel->onsets.peak = next_state(next, 1);
    channel->onset_partials = (OnsetPartial *)next_state(next, ONSET_PARTIAL_NUMBERS * s->onset_partials_max);
    double **of_slots[SLOT_NUMBERS] = {
        &channel->slots.hz,            &channel->slots.amplitude,  &channel->slots.phase,
        &channel->slots.alive,         &channel->slots.held_first, &channel->slots.held_last,
        &channel->slots.held_loudness, &channel->slots.held_hops,  &channel->slots.held_amplitude,
        &channel->slots.held_weight,   &channel->slots.lacking,
    };
    for (size_t which = 0; which < SLOT_NUMBERS; which++)
        *of_slots[which] = next_state(next, slots);
    channel->slots.start_sum = next_state(next, 1);
    channel->begun = next_state(next, 1);
    channel->smoothing.state = next_state(next, smoothing_states(s));
    channel->smoothing.tail = next_state(next, smoothing_tail(s));
    channel->tail = next_state(next, 1);
    channel->speech = (Speech *)next_state(next, SPEECH_STATES);
    if (loudness_is_on(s))
        layout_followed(s, channel, next);
    else
        channel->hop_low_rate = next_state(next, s->steps);
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
    double **onset_glides[GLIDE_NUMBERS] = {
        &live->onset_glides.start_hz,      &live->onset_glides.end_hz,
        &live->onset_glides.start_amplitude, &live->onset_glides.end_amplitude,
        &live->onset_glides.start_phase,
    };
    for (size_t which = 0; which < GLIDE_NUMBERS; which++)
        *onset_glides[which] = numbers(arena, s->onset_partials_max);
}

int live_open(Live *live, const Settings *settings, size_t channels, int per_channel, Arena *arena)
{
    memset(live, 0, sizeof *live);
    live->settings = *settings;
    live->sound_channels = channels;
    live->per_channel = per_channel;
    live->channels_count = per_channel ? channels : 1;
    live->mix_weights = per_channel ? NULL : downmix_weights(&live->settings, channels);
    live->state_length = live->channels_count * channel_numbers(settings) + DOWNMIX_STATE_NUMBERS;
    if (!fft_open(&live->fft, settings->fft_length, 1, arena) ||
        !fft_open(&live->short_fft, settings->short_length, 0, arena))
        return 0;
    live->channels = arena_alloc(arena, live->channels_count, sizeof(Channel));
    live->state = numbers(arena, live->state_length);
    layout_work(live, arena);
    if (!live->state)
        return 1;
    double *next = live->state;
    for (size_t channel = 0; channel < live->channels_count; channel++)
        layout_channel(settings, &live->channels[channel], &next);
    live->downmix_state = (DownmixState *)next_state(&next, DOWNMIX_STATE_NUMBERS);
    live_reset(live);
    return 1;
}

void live_reset(Live *live)
{
    memset(live->state, 0, live->state_length * sizeof(double));
    live->filled = live->tick = live->oldest = 0;
    live->display.count = 0;
    live->silent = live->settings.window_frames; /* before the beginning there was nothing */
    for (size_t channel = 0; channel < live->channels_count; channel++) {
        onsets_reset(&live->settings, &live->channels[channel].onsets);
        if (loudness_is_on(&live->settings))
            strength_reset(&live->settings, live->channels[channel].strength);
        live_rest(live, &live->channels[channel]);
    }
}

void live_rest(Live *live, Channel *channel)
{
    const Settings *s = &live->settings;
    if (!loudness_is_on(s))
        return;
    band_powers_reset(s, &channel->powers);
    strength_rest(s, channel->strength);
    *channel->oscillators.drive = (Drive){.beat = 1.0};
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

static int channel_is_valid(const Settings *s, const Channel *channel)
{
    size_t alive = 0;
    for (size_t slot = 0; slot < tracking_slots(s); slot++) {
        alive += channel->slots.alive[slot] != 0.0;
        if (!are_bands(s, channel->slots.held_first[slot], channel->slots.held_last[slot]) ||
            !is_count(channel->slots.held_hops[slot], 0.0, (double)s->hold_hops + 1.0))
            return 0;
    }
    const double oldest = (double)s->heard_ticks + (double)s->rise_shares.length;
    for (size_t slot = 0; slot < s->onset_partials_max; slot++) {
        const OnsetPartial *one = &channel->onset_partials[slot];
        if (!are_bands(s, one->first_band, one->last_band) ||
            !is_count(one->age, 0.0, oldest))
            return 0;
    }
    return alive <= s->partials_max + s->onset_partials_max &&
           is_count(*channel->onsets.since, 0.0, (double)(s->rest_ticks + s->heard_ticks)) &&
           *channel->tail >= 0.0 && *channel->tail <= (double)s->ring_hops &&
           is_count(*channel->begun, 0.0, (double)(s->begin_frames + s->begin_fade.length)) &&
           (!loudness_is_on(s) || (strength_is_possible(s, channel->strength) &&
                                   oscillators_are_possible(s, channel->oscillators.drive)));
}

int live_state_is_valid(const Live *live)
{
    const Settings *s = &live->settings;
    if (live->filled >= s->tick_frames || live->tick >= s->ticks ||
        live->oldest >= s->window_frames || live->silent > s->window_frames ||
        !downmix_is_possible(live->downmix_state))
        return 0;
    for (size_t which = 0; which < live->channels_count; which++)
        if (!channel_is_valid(s, &live->channels[which]))
            return 0;
    return 1;
}
