/* Memory layout of the real-time transform. */

#include "live.h"

static void layout_channel(const Settings *s, Channel *channel, Arena *arena)
{
    const size_t bands = onsets_bands(s);
    channel->band = arena_doubles(arena, s->band_b.length - 1);
    channel->past = arena_doubles(arena, s->window_frames);
    channel->peaks = arena_doubles(arena, s->hops_in_window);
    channel->output_tick = arena_doubles(arena, s->tick_frames);
    channel->onsets.peaks = arena_doubles(arena, s->short_ticks);
    channel->onsets.past = arena_doubles(arena, s->back_ticks * bands);
    channel->onsets.highest = arena_doubles(arena, bands);
    channel->onsets.rising = arena_doubles(arena, bands);
    channel->onsets.power = arena_doubles(arena, s->short_bins);
    channel->onset_partials = arena_alloc(arena, s->onset_partials_max, sizeof(OnsetPartial));
    arena_arrays(arena, (double **)&channel->slots, SLOT_ARRAYS, tracking_slots(s));
    channel->slots.held = arena_alloc(arena, tracking_slots(s), sizeof(Held));
    channel->smoothing.state = arena_doubles(arena, smoothing_states(s));
    channel->smoothing.tail = arena_doubles(arena, smoothing_tail(s));
    if (loudness_is_on(s)) {
        channel->powers.recent = arena_doubles(arena, (s->average_ticks - 1) * s->high_weights.length);
        arena_arrays(arena, ARRAYS(channel->oscillators.hop), tracking_slots(s));
    } else {
        channel->hop_low_rate = arena_doubles(arena, s->steps);
    }
}

void live_layout_state(Live *live, Arena *arena)
{
    Channel counted;
    live->memory = *arena;
    live->state = arena_alloc(arena, 1, sizeof(LiveState));
    live->channels = arena_alloc(arena, live->channels_count, sizeof(Channel));
    for (size_t which = 0; which < live->channels_count; which++)
        layout_channel(&live->settings, live->channels ? live->channels + which : &counted, arena);
    live->memory_bytes = arena->used - live->memory.used;
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
    live->tracking = tracking_layout(s, arena);
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
    memset(live, 0, sizeof *live);
    live->settings = *settings;
    live->per_channel = per_channel;
    live->channels_count = per_channel ? channels : 1;
    live->mix_weights = per_channel ? NULL : downmix_weights(&live->settings, channels);
    if (!fft_open(&live->fft, settings->fft_length, 1, arena) ||
        !fft_open(&live->short_fft, settings->short_length, 0, arena))
        return 0;
    layout_work(live, arena);
    return 1;
}

void live_reset(Live *live)
{
    const Settings *s = &live->settings;
    const LiveState before = *live->state;
    Arena arena = live->memory;
    memset(arena_whole(arena, live->memory_bytes), 0, live->memory_bytes);
    live_layout_state(live, &arena);
    /* A new stream starts like a stream after a window of silence. */
    *live->state = (LiveState){
        .silent = s->window_frames, .replaced = before.replaced, .limited = before.limited};
    live->display.count = 0;
    for (size_t which = 0; which < live->channels_count; which++) {
        Channel *channel = &live->channels[which];
        onsets_reset(s, &channel->onsets);
        if (loudness_is_on(s))
            strength_reset(s, &channel->strength);
        live_rest(live, channel);
    }
}

void live_rest(Live *live, Channel *channel)
{
    const Settings *s = &live->settings;
    if (!loudness_is_on(s))
        return;
    band_powers_reset(s, &channel->powers);
    strength_rest(s, &channel->strength);
    channel->oscillators.drive = (Drive){.beat = 1.0};
}
