/* Processes a stream in ticks (about 2 ms) and hops (about 18 ms). The block size does not change the output.
 *
 * Band-passed frames fill a ring buffer of one window. At the end of every tick, this tick is searched for
 * an onset, and the next tick of vibration is computed. At the end of every hop, the window is analysed
 * unless it is silent. */

#include "live.h"
#include "scaling.h"

/* Copy the newest `count` frames of a channel into live->newest, the oldest first. */
static void copy_newest(const Live *live, const Channel *channel, size_t count)
{
    const size_t frames = live->settings.window_frames, last = live->state->oldest ? live->state->oldest : frames;
    const size_t wrapped = last < count ? count - last : 0, rest = count - wrapped;
    memcpy(live->newest, channel->past + frames - wrapped, wrapped * sizeof(double));
    memcpy(live->newest + wrapped, channel->past + last - rest, rest * sizeof(double));
}

/* Compute the window's spectrum and find its principal frequencies. Return their number; if the strength
 * `wanted` is 0, find none. */
static size_t analyse_window(Live *live, const Channel *channel, double wanted)
{
    const Settings *s = &live->settings;
    copy_newest(live, channel, s->window_frames);
    apply_window(live->newest, s->window.at, s->window_frames, live->windowed);
    fft_spectrum(&live->fft, live->windowed, s->bins, live->real, live->imaginary, live->fft_space);
    if (!(wanted > 0.0))
        return 0;
    const Spectrum spectrum = {live->real, live->imaginary};
    return (size_t)find_principal(s, spectrum, live->found, live->analysis_space);
}

/* Add a channel's partials of a hop to the display, which keeps the strongest. wanted: target strength. */
static void publish_partials(Live *live, double wanted, size_t count)
{
    DisplayPartials *display = &live->display;
    const double gain = loudness_is_on(&live->settings) ? levels_gain(live, wanted, count) : 1.0;
    for (size_t one = 0; one < count; one++) {
        const double row[3] = {live->found.audio_hz[one], live->hz[one], gain * live->amplitude[one]};
        size_t at = display->count;
        if (at == CORE_PARTIALS) {
            at = 0;
            for (size_t other = 1; other < CORE_PARTIALS; other++)
                if (display->rows[other][2] < display->rows[at][2])
                    at = other;
            if (row[2] <= display->rows[at][2])
                continue;
        } else {
            display->count++;
        }
        memcpy(display->rows[at], row, sizeof row);
    }
}

static void follow(Live *live, Channel *channel, Glides *glides, double wanted, size_t count)
{
    const Settings *s = &live->settings;
    const double left = tracking_holds(s, &channel->slots) ? levels_left_by_law(live, count) : 1.0;
    for (size_t one = 0; one < count; one++)
        live->hz[one] = vibration_hz(s, live->found.audio_hz[one]);
    if (levels_set(live, channel, count))
        live->state->limited += s->hop_frames;
    publish_partials(live, wanted, count);
    const double total = sum(live->amplitude, count);
    for (size_t one = 0; one < count; one++)
        live->amplitude[one] *= smoothing_gain(s, live->hz[one]);
    const Partials partials = {live->found.audio_hz, live->hz, live->amplitude, count};
    const double room = loudness_is_on(s) ? INFINITY : larger(0.0, s->ceiling - total);
    tracking_follow(s, &channel->slots, glides, partials, room, left, &channel->onsets,
                    &live->tracking);
}

static size_t number_of(const Live *live, const Channel *channel)
{
    return (size_t)(channel - live->channels);
}

/* Analyse the window and write the glides of the next hop. wanted: target strength at that hop's start. */
static void end_hop(Live *live, Channel *channel, double wanted)
{
    const Settings *s = &live->settings;
    const int followed = loudness_is_on(s);
    Glides *glides = followed ? &channel->oscillators.hop : &live->glides;
    const double loudest = maximum(channel->peaks, s->hops_in_window);
    memmove(channel->peaks, channel->peaks + 1, (s->hops_in_window - 1) * sizeof(double));
    channel->peaks[s->hops_in_window - 1] = 0.0;

    onset_partials_hand_over(s, channel->onset_partials, &channel->onsets, &channel->slots);
    size_t count = 0;
    const int audible = loudest >= s->silence;
    if (audible)
        count = analyse_window(live, channel, wanted);
    if (s->speech_db > 0.0 && audible)
        speech_update(s, &channel->speech, live->real, live->imaginary, live->speech_space);
    else if (s->speech_db > 0.0)
        speech_pause(s, &channel->speech);
    if (count || tracking_holds(s, &channel->slots)) {
        follow(live, channel, glides, wanted, count);
        channel->tail = (double)s->ring_hops;
    } else if (tracking_sounds(s, &channel->slots)) {
        tracking_fade(s, &channel->slots, glides);
    } else {
        if (channel->tail > 0.0)
            channel->tail -= 1.0;
        tracking_rest(s, glides);
    }
    if (followed) {
        oscillators_begin_hop(s, &channel->oscillators);
        return;
    }
    glide_log_add_all(&live->log, glides, number_of(live, channel), 0, tracking_slots(s), s->hop_frames);
    synthesis_hop(s, glides, channel->hop_low_rate);
}

/* Write the next tick to live->low_rate, with the partials' own amplitudes. full: 1 at the end of a hop. */
static void play_levels(Live *live, const Channel *channel, int onset_sounds, int full)
{
    const Settings *s = &live->settings;
    const double *hop = channel->hop_low_rate + (full ? 0 : (live->state->tick + 1) * s->tick_steps);
    memset(live->low_rate, 0, s->tick_steps * sizeof(double));
    if (onset_sounds) {
        glide_log_add_all(&live->log, &live->onset_glides, number_of(live, channel), tracking_slots(s),
                          s->onset_partials_max, s->tick_frames);
        synthesis_add_onsets(s, &live->onset_glides, live->low_rate);
    }
    for (size_t step = 0; step < s->tick_steps; step++)
        live->low_rate[step] += hop[step];
}

/* Write the next tick to live->low_rate, with the target strength `wanted`. full: 1 at the end of a hop. */
static void play_strength(Live *live, Channel *channel, int onset_sounds, int full, double wanted)
{
    const Settings *s = &live->settings;
    const OscillatorTick now = {full ? 0 : live->state->tick + 1, onset_sounds ? &live->onset_glides : NULL, wanted,
                                &live->log, number_of(live, channel)};
    live->state->limited += s->decimation * oscillators_play(s, &channel->oscillators, now, live->low_rate,
                                                      live->oscillator_space);
}

/* Process a complete tick of sound, and compute the next tick of vibration. */
static void advance(Live *live, Channel *channel)
{
    const Settings *s = &live->settings;
    const int followed = loudness_is_on(s), full = live->state->tick + 1 == s->ticks;
    int onset = 0;
    if (s->find_onsets || followed) {
        copy_newest(live, channel, s->short_frames);
        onset = onsets_detect(s, &live->short_fft, &channel->onsets, live->newest, live->onset_space) &&
                s->find_onsets;
    }
    const OnsetSources sources = {&channel->onsets, &channel->speech};
    double wanted = 1.0;
    if (followed)
        wanted = strength_of_tick(s, &channel->powers, &channel->strength,
                                  live->newest + (s->short_frames - s->tick_frames), live->onset_space);
    if (full)
        end_hop(live, channel, wanted);
    if (onset)
        onset_partials_start(s, channel->onset_partials, sources, &channel->slots,
                            full ? s->ticks : s->ticks - 1 - live->state->tick);
    const int onset_sounds = onset_partials_sounds(s, channel->onset_partials);
    if (onset_sounds) {
        channel->tail = (double)s->ring_hops;
        onset_partials_play(s, channel->onset_partials, sources, &channel->slots, &live->onset_glides);
    }
    if (followed)
        play_strength(live, channel, onset_sounds, full, wanted);
    else if (channel->tail > 0.0)
        play_levels(live, channel, onset_sounds, full);
    if (channel->tail > 0.0) {
        synthesis_play(s, live->low_rate, &channel->smoothing, channel->output_tick, live->synthesis_space);
        live->state->limited += synthesis_keep_below_full_scale(s, channel->output_tick);
    } else {
        /* A channel at rest outputs exactly 0. Its output filters and its interpolation are cleared. */
        smoothing_reset(s, &channel->smoothing);
        memset(channel->output_tick, 0, s->tick_frames * sizeof(double));
    }
}

/* Mix and band-pass frames into a channel's ring buffer. silent: all frames are exactly 0. */
static void collect(Live *live, Channel *channel, CoreSound sound, size_t channels, size_t frames, int silent)
{
    const Settings *s = &live->settings;
    double loudest;
    if (silent) {
        if (live->mix_weights)
            downmix_rest(s, &live->state->downmix, frames);
        loudest = input_band_pass_silence(s, channel->band, live->mono, frames);
    } else {
        live->state->replaced += input_mix(s, &live->state->downmix, sound, channels, live->mix_weights, frames,
                                           live->mono, live->side);
        loudest = input_band_pass(s, channel->band, live->mono, frames);
    }
    double *of_hop = &channel->peaks[s->hops_in_window - 1];
    double *of_tick = &channel->onsets.peaks[s->short_ticks - 1];
    *of_hop = larger(loudest, *of_hop);
    *of_tick = larger(loudest, *of_tick);
    const double *from = live->mono;
    size_t at = live->state->oldest;
    while (frames) {
        const size_t room = s->window_frames - at, part = frames < room ? frames : room;
        memcpy(channel->past + at, from, part * sizeof(double));
        from += part;
        frames -= part;
        at = at + part == s->window_frames ? 0 : at + part;
    }
}

/* Mute and then fade in the start of a stream, since a file may start abruptly. apart: samples per frame. */
static void begin(const Settings *s, double *begun, double *vibration, size_t frames, size_t apart)
{
    const size_t fade = s->begin_fade.length, first = s->begin_frames;
    for (size_t frame = 0; frame < frames && *begun < (double)(first + fade); frame++, *begun += 1.0) {
        const size_t at = (size_t)*begun;
        vibration[frame * apart] *= at < first ? 0.0 : s->begin_fade.at[at - first];
    }
}

static void deliver(const Channel *channel, size_t from, size_t frames, double *vibration, size_t apart)
{
    const double *output_tick = channel->output_tick + from;
    if (apart == 1)
        memcpy(vibration, output_tick, frames * sizeof(double));
    else
        for (size_t frame = 0; frame < frames; frame++)
            vibration[frame * apart] = output_tick[frame];
}

/* Update LiveState.silent; return whether all given frames are silent. */
static int note_silence(Live *live, CoreSound sound, size_t channels, size_t frames)
{
    const size_t silent = input_silent_last(sound, channels, frames);
    const size_t total = silent == frames ? live->state->silent + frames : silent;
    live->state->silent = total < live->settings.window_frames ? total : live->settings.window_frames;
    return silent == frames;
}

/* Return whether, in all channels, the output is 0, no partial sounds and the speech detection is cleared. */
static int asleep(const Live *live)
{
    for (size_t which = 0; which < live->channels_count; which++) {
        const Channel *channel = &live->channels[which];
        if (channel->tail > 0.0 || tracking_sounds(&live->settings, &channel->slots) ||
            !speech_is_at_rest(&channel->speech))
            return 0;
    }
    return 1;
}

/* Return how many frames to process next: normally `frames`. After a window of silence, if the first frame is
 * silent too, return the number of leading silent frames, at most the rest of the tick. If it is not silent
 * but all channels are asleep, start a hop, so that the vibration does not depend on the length of the
 * silence. */
static size_t up_to_onset(Live *live, CoreSound sound, size_t channels, size_t frames)
{
    if (live->state->silent < live->settings.window_frames)
        return frames;
    const size_t room = live->settings.tick_frames - live->state->filled;
    const size_t most = frames < room ? frames : room;
    const size_t silent = input_silent_first(sound, channels, most);
    if (silent)
        return silent;
    if (asleep(live)) {
        live->state->filled = live->state->tick = 0;
        memset(&live->state->downmix, 0, sizeof live->state->downmix);
        for (size_t which = 0; which < live->channels_count; which++) {
            onsets_reset(&live->settings, &live->channels[which].onsets);
            live_rest(live, &live->channels[which]);
        }
    }
    return frames;
}

/* Copy programme and sound_ticks of the loudest channel to all channels, so quieter ones stay quieter. */
static void share_programme(Live *live)
{
    const Strength *loudest = &live->channels[0].strength;
    for (size_t which = 1; which < live->channels_count; which++)
        if (live->channels[which].strength.loud > loudest->loud)
            loudest = &live->channels[which].strength;
    const double programme = loudest->programme, sound_ticks = loudest->sound_ticks;
    for (size_t which = 0; which < live->channels_count; which++) {
        live->channels[which].strength.programme = programme;
        live->channels[which].strength.sound_ticks = sound_ticks;
    }
}

void live_process(Live *live, CoreSound sound, size_t channels, size_t frames, double *vibration)
{
    const Settings *s = &live->settings;
    while (frames) {
        const size_t same = up_to_onset(live, sound, channels, frames);
        const size_t room = s->tick_frames - live->state->filled, part = same < room ? same : room;
        const int silent = note_silence(live, sound, channels, part);
        for (size_t which = 0; which < live->channels_count; which++) {
            Channel *channel = &live->channels[which];
            if (live->per_channel)
                collect(live, channel, sound_from(sound, 0, which), 1, part, silent);
            else
                collect(live, channel, sound, channels, part, silent);
            deliver(channel, live->state->filled, part, vibration + which, live->channels_count);
            if (s->begin_fade.length)
                begin(s, &channel->begun, vibration + which, part, live->channels_count);
        }
        sound = sound_from(sound, part, 0);
        vibration += part * live->channels_count;
        frames -= part;
        live->state->filled += part;
        live->log.frame += part;
        live->state->oldest = (live->state->oldest + part) % s->window_frames;
        if (live->state->filled == s->tick_frames) {
            live->state->filled = 0;
            if (live->state->tick + 1 == s->ticks) {
                live->display.count = 0;
                live->display.hops++;
            }
            for (size_t which = 0; which < live->channels_count; which++)
                advance(live, &live->channels[which]);
            live->state->tick = (live->state->tick + 1) % s->ticks;
            if (loudness_is_on(s))
                share_programme(live);
        }
    }
}
