/* The live form's memory: where everything of a stream lies, and what its state may be. */

#include "live.h"

#define ONSET_PARTIAL_NUMBERS (sizeof(OnsetPartial) / sizeof(double))

/* The state, which is one piece, so that it can be kept and returned to; without memory, only counted. */
typedef struct {
    double *at;
    size_t used;
} State;

static double *next_state(State *state, size_t count)
{
    state->used += count;
    return state->at ? state->at + state->used - count : NULL;
}

static void next_states(State *state, double **arrays, size_t arrays_count, size_t count)
{
    for (size_t which = 0; which < arrays_count; which++)
        arrays[which] = next_state(state, count);
}

/* Lay out what is remembered only where loudness is followed. */
static void layout_followed(const Settings *s, Channel *channel, State *state)
{
    channel->powers.low = (LowBands *)next_state(state, LOW_STATES);
    channel->powers.recent = next_state(state, (s->average_ticks - 1) * s->high_weights.length);
    channel->strength = (Strength *)next_state(state, STRENGTH_STATES);
    channel->oscillators.drive = (Drive *)next_state(state, DRIVE_STATES);
    next_states(state, ARRAYS(channel->oscillators.hop), tracking_slots(s));
}

static void layout_channel(const Settings *s, Channel *channel, State *state)
{
    const size_t bands = onsets_bands(s);
    channel->band = next_state(state, s->band_b.length - 1);
    channel->past = next_state(state, s->window_frames);
    channel->peaks = next_state(state, s->hops_in_window);
    channel->output_tick = next_state(state, s->tick_frames);
    channel->onsets.peaks = next_state(state, s->short_ticks);
    channel->onsets.past = next_state(state, s->back_ticks * bands);
    channel->onsets.highest = next_state(state, bands);
    channel->onsets.rising = next_state(state, bands);
    channel->onsets.power = next_state(state, s->short_bins);
    channel->onsets.since = next_state(state, 1);
    channel->onsets.newest = next_state(state, 1);
    channel->onsets.peak = next_state(state, 1);
    channel->onset_partials =
        (OnsetPartial *)next_state(state, ONSET_PARTIAL_NUMBERS * s->onset_partials_max);
    next_states(state, (double **)&channel->slots, SLOT_ARRAYS, tracking_slots(s));
    channel->slots.start_sum = next_state(state, 1);
    channel->begun = next_state(state, 1);
    channel->smoothing.state = next_state(state, smoothing_states(s));
    channel->smoothing.tail = next_state(state, smoothing_tail(s));
    channel->tail = next_state(state, 1);
    channel->speech = (Speech *)next_state(state, SPEECH_STATES);
    if (loudness_is_on(s))
        layout_followed(s, channel, state);
    else
        channel->hop_low_rate = next_state(state, s->steps);
}

static void layout_work(Live *live, Arena *arena)
{
    const Settings *s = &live->settings;
    live->mono = arena_doubles(arena, s->tick_frames);
    live->side = arena_doubles(arena, s->tick_frames);
    live->newest = arena_doubles(arena, s->window_frames);
    live->onset_space = arena_doubles(arena, onsets_work(s, &live->short_fft));
    live->windowed = arena_doubles(arena, live->fft.frames);
    live->real = arena_doubles(arena, s->bins);
    live->imaginary = arena_doubles(arena, s->bins);
    live->fft_space = arena_doubles(arena, fft_work(&live->fft));
    live->tracking_space = arena_alloc(arena, tracking_work(s), 1);
    live->synthesis_space = arena_doubles(arena, synthesis_work(s));
    live->low_rate = arena_doubles(arena, s->tick_steps);
    live->oscillator_space = arena_doubles(arena, oscillators_work(s));
    live->speech_space = arena_doubles(arena, speech_work(s));
    live->analysis_space = arena_alloc(arena, analysis_work(s->bins), 1);
    arena_arrays(arena, ARRAYS(live->found), s->partials_max);
    live->hz = arena_doubles(arena, s->partials_max);
    live->amplitude = arena_doubles(arena, s->partials_max);
    arena_arrays(arena, ARRAYS(live->glides), tracking_slots(s));
    arena_arrays(arena, ARRAYS(live->onset_glides), s->onset_partials_max);
}

int live_open(Live *live, const Settings *settings, size_t channels, int per_channel, Arena *arena)
{
    Channel counted;
    State state = {NULL, 0};
    memset(live, 0, sizeof *live);
    live->settings = *settings;
    live->per_channel = per_channel;
    live->channels_count = per_channel ? channels : 1;
    live->mix_weights = per_channel ? NULL : downmix_weights(&live->settings, channels);
    layout_channel(settings, &counted, &state);
    live->state_length = live->channels_count * state.used + DOWNMIX_STATE_NUMBERS;
    if (!fft_open(&live->fft, settings->fft_length, 1, arena) ||
        !fft_open(&live->short_fft, settings->short_length, 0, arena))
        return 0;
    live->channels = arena_alloc(arena, live->channels_count, sizeof(Channel));
    live->state = arena_doubles(arena, live->state_length);
    layout_work(live, arena);
    if (!live->state)
        return 1;
    state = (State){live->state, 0};
    for (size_t channel = 0; channel < live->channels_count; channel++)
        layout_channel(settings, &live->channels[channel], &state);
    live->downmix_state = (DownmixState *)next_state(&state, DOWNMIX_STATE_NUMBERS);
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
