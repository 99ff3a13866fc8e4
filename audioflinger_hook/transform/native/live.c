/* The live form's hops and ticks.
 *
 * Frames are band-passed as they come, into a ring that holds one window. When a tick is full, the
 * onsets in it are looked for, and where a hop is full as well its window is analysed. The tick's
 * vibration is computed then, and delivered frame by frame as the next tick comes in. A block only
 * decides when that happens, so any split of a stream gives the same bytes.
 */

#include "live.h"

#include "scaling.h"

/* ------------------------------------------------------------------------------------- analysis */

/* Copy the last `count` frames of a channel, in order, into live->newest. */
static void copy_newest(const Live *live, const Channel *channel, size_t count)
{
    const size_t frames = live->settings.window_frames, last = live->oldest ? live->oldest : frames;
    const size_t wrapped = last < count ? count - last : 0, rest = count - wrapped;
    memcpy(live->newest, channel->past + frames - wrapped, wrapped * sizeof(double));
    memcpy(live->newest + wrapped, channel->past + last - rest, rest * sizeof(double));
}

/* Find the principal tones of the window; return how many, 0 where none vibrates. wanted: strength of
 * the vibration. */
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

/* -------------------------------------------------------------------------------------- one hop */

/* Publish the partials of a hop; of too many, the weakest are left out. wanted: strength. */
static void publish_partials(Live *live, double wanted, size_t count)
{
    DisplayPartials *display = &live->display;
    const double gain = loudness_is_on(&live->settings) ? levels_gain(live, wanted, count) : 1.0;
    for (size_t one = 0; one < count; one++) {
        size_t at = display->count;
        if (at < DISPLAY_PARTIALS_MAX) {
            display->count++;
        } else {
            at = 0;
            for (size_t other = 1; other < DISPLAY_PARTIALS_MAX; other++)
                if (display->amplitude[other] < display->amplitude[at])
                    at = other;
            if (gain * live->amplitude[one] <= display->amplitude[at])
                continue;
        }
        display->audio_hz[at] = live->found.audio_hz[one];
        display->hz[at] = live->hz[one];
        display->amplitude[at] = gain * live->amplitude[one];
    }
}

static void follow(Live *live, Channel *channel, Glides *glides, double wanted, size_t count)
{
    const Settings *s = &live->settings;
    const double left = tracking_holds(s, &channel->slots) ? levels_left_by_law(live, count) : 1.0;
    for (size_t one = 0; one < count; one++)
        live->hz[one] = vibration_hz(s, live->found.audio_hz[one]);
    if (levels_set(live, channel, count))
        live->limited += s->hop_frames;
    publish_partials(live, wanted, count);
    const double total = sum(live->amplitude, count);
    for (size_t one = 0; one < count; one++)
        live->amplitude[one] *= smoothing_gain(s, live->hz[one]);
    const Partials partials = {live->found.audio_hz, live->hz, live->amplitude, count};
    const double room = loudness_is_on(s) ? INFINITY : larger(0.0, s->ceiling - total);
    tracking_follow(s, &channel->slots, glides, partials, room, left, &channel->onsets,
                    live->tracking_space);
}

static size_t number_of(const Live *live, const Channel *channel)
{
    return (size_t)(channel - live->channels);
}

/* Find the next hop of the partials. wanted: strength at its start. */
static void end_hop(Live *live, Channel *channel, double wanted)
{
    const Settings *s = &live->settings;
    const int followed = loudness_is_on(s);
    Glides *glides = followed ? &channel->oscillators.hop : &live->glides;
    double loudest = 0.0;
    for (size_t hop = 0; hop < s->hops_in_window; hop++)
        loudest = larger(channel->peaks[hop], loudest);
    memmove(channel->peaks, channel->peaks + 1, (s->hops_in_window - 1) * sizeof(double));
    channel->peaks[s->hops_in_window - 1] = 0.0;

    onset_partials_hand_over(s, channel->onset_partials, &channel->onsets, &channel->slots);
    size_t count = 0;
    const int audible = loudest >= s->silence;
    if (audible)
        count = analyse_window(live, channel, wanted);
    if (s->speech_db > 0.0 && audible)
        speech_update(s, channel->speech, live->real, live->imaginary, live->speech_space);
    else if (s->speech_db > 0.0)
        speech_pause(s, channel->speech);
    if (count || tracking_holds(s, &channel->slots)) {
        follow(live, channel, glides, wanted, count);
        *channel->tail = (double)s->ring_hops;
    } else if (tracking_sounds(s, &channel->slots)) {
        tracking_fade(s, &channel->slots, glides);
    } else {
        if (*channel->tail > 0.0)
            *channel->tail -= 1.0;
        tracking_rest(s, glides);
    }
    if (followed) {
        oscillators_begin_hop(s, &channel->oscillators);
        return;
    }
    glide_log_add_all(&live->log, glides, number_of(live, channel), 0, tracking_slots(s), s->hop_frames);
    synthesis_hop(s, glides, channel->hop_low_rate);
}

/* -------------------------------------------------------------------------------------- one tick */

/* Look for an onset in the tick that is full; `newest` and the powers of its bins are known then. */
static int find_onset(Live *live, const Channel *channel)
{
    const Settings *s = &live->settings;
    copy_newest(live, channel, s->short_frames);
    return onsets_detect(s, &live->short_fft, &channel->onsets, live->newest, live->onset_space);
}

/* How strong the next tick vibrates at its end, by the loudness of the one that is full. */
static double find_strength(const Live *live, const Channel *channel)
{
    const Settings *s = &live->settings;
    double excitation[BANDS_MAX];
    band_powers_update(s, &channel->powers, live->newest + (s->short_frames - s->tick_frames),
                     live->onset_space, excitation);
    const Loudness loudness = loudness_of(s, excitation);
    return strength_follow(s, channel->strength, &loudness);
}

/* Write the next tick at the low rate: all partials by their own amplitudes. */
static void play_levels(Live *live, const Channel *channel, int onset_sounds, int full)
{
    const Settings *s = &live->settings;
    const double *hop = channel->hop_low_rate + (full ? 0 : (live->tick + 1) * s->tick_steps);
    memset(live->low_rate, 0, s->tick_steps * sizeof(double));
    if (onset_sounds) {
        glide_log_add_all(&live->log, &live->onset_glides, number_of(live, channel), tracking_slots(s),
                          s->onset_partials_max, s->tick_frames);
        synthesis_add_onsets(s, &live->onset_glides, live->low_rate);
    }
    for (size_t step = 0; step < s->tick_steps; step++)
        live->low_rate[step] += hop[step];
}

/* The same as strong as is wanted. */
static void play_strength(Live *live, const Channel *channel, int onset_sounds, int full, double wanted)
{
    const Settings *s = &live->settings;
    const OscillatorTick now = {full ? 0 : live->tick + 1, onset_sounds ? &live->onset_glides : NULL, wanted,
                                &live->log, number_of(live, channel)};
    live->limited += s->decimation * oscillators_play(s, &channel->oscillators, now, live->low_rate,
                                                      live->oscillator_space);
}

/* Compute the vibration that follows the tick that is full now. */
static void advance(Live *live, Channel *channel)
{
    const Settings *s = &live->settings;
    const int followed = loudness_is_on(s), full = live->tick + 1 == s->ticks;
    const int onset = (s->find_onsets || followed) && find_onset(live, channel) && s->find_onsets;
    const OnsetSources sources = {&channel->onsets, channel->speech};
    const double wanted = followed ? find_strength(live, channel) : 1.0;
    if (full)
        end_hop(live, channel, wanted);
    if (onset)
        onset_partials_start(s, channel->onset_partials, sources, &channel->slots,
                            full ? s->ticks : s->ticks - 1 - live->tick);
    const int onset_sounds = onset_partials_sounds(s, channel->onset_partials);
    if (onset_sounds) {
        *channel->tail = (double)s->ring_hops;
        onset_partials_play(s, channel->onset_partials, sources, &channel->slots, &live->onset_glides);
    }
    if (followed)
        play_strength(live, channel, onset_sounds, full, wanted);
    else if (*channel->tail > 0.0)
        play_levels(live, channel, onset_sounds, full);
    if (*channel->tail > 0.0) {
        synthesis_play(s, live->low_rate, &channel->smoothing, channel->output_tick, live->synthesis_space);
        live->limited += synthesis_keep_below_full_scale(s, channel->output_tick);
    } else {
        /* What sleeps is exactly 0 and forgets its tail. */
        smoothing_reset(s, &channel->smoothing);
        memset(channel->output_tick, 0, s->tick_frames * sizeof(double));
    }
}

/* -------------------------------------------------------------------------------------- a block */

/* Take frames into a channel's window. silent: all of them are exactly 0. */
static void collect(Live *live, Channel *channel, Sound sound, size_t frames, int silent)
{
    const Settings *s = &live->settings;
    double loudest;
    if (silent) {
        if (live->mix_weights)
            downmix_rest(s, live->downmix_state, frames);
        loudest = input_band_pass_silence(s, channel->band, live->mono, frames);
    } else {
        const double *weights = live->mix_weights;
        live->replaced += input_mix(s, sound, weights, frames, live->mono, live->side);
        if (weights)
            downmix_restore(s, live->downmix_state, live->mono, live->side, frames);
        loudest = input_band_pass(s, channel->band, live->mono, frames);
    }
    double *of_hop = &channel->peaks[s->hops_in_window - 1];
    double *of_tick = &channel->onsets.peaks[s->short_ticks - 1];
    *of_hop = larger(loudest, *of_hop);
    *of_tick = larger(loudest, *of_tick);
    const double *from = live->mono;
    size_t at = live->oldest;
    while (frames) {
        const size_t room = s->window_frames - at, part = frames < room ? frames : room;
        memcpy(channel->past + at, from, part * sizeof(double));
        from += part;
        frames -= part;
        at = at + part == s->window_frames ? 0 : at + part;
    }
}

/* Let a stream fade in: what came before its first frame is cut off in files. */
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

/* Count the silence that these frames end with; return whether they are nothing else. */
static int note_silence(Live *live, Sound sound, size_t frames)
{
    const size_t silent = input_silent_last(sound, frames);
    const size_t total = silent == frames ? live->silent + frames : silent;
    live->silent = total < live->settings.window_frames ? total : live->settings.window_frames;
    return silent == frames;
}

/* Whether nothing is played, and earlier sound has no effect any more. */
static int asleep(const Live *live)
{
    for (size_t which = 0; which < live->channels_count; which++) {
        const Channel *channel = &live->channels[which];
        if (*channel->tail > 0.0 || tracking_sounds(&live->settings, &channel->slots) ||
            !speech_is_at_rest(channel->speech))
            return 0;
    }
    return 1;
}

/* Return how many of these frames go on as they are. A hop begins with the first that follows
 * silence: the same sound so gives the same vibration however long the silence before it was. Looks
 * no further than the tick under way: a long block would be looked through for each of its ticks. */
static size_t up_to_onset(Live *live, Sound sound, size_t frames)
{
    if (live->silent < live->settings.window_frames)
        return frames;
    const size_t room = live->settings.tick_frames - live->filled;
    const size_t most = frames < room ? frames : room;
    const size_t silent = input_silent_first(sound, most);
    if (silent)
        return silent;
    if (asleep(live)) {
        live->filled = live->tick = 0;
        memset(live->downmix_state, 0, sizeof *live->downmix_state);
        for (size_t which = 0; which < live->channels_count; which++) {
            onsets_reset(&live->settings, &live->channels[which].onsets);
            live_rest(live, &live->channels[which]);
        }
    }
    return frames;
}

/* Let the programme be that of the loudest channel: what is softer on one side stays so. */
static void share_programme(Live *live)
{
    const Strength *loudest = live->channels[0].strength;
    for (size_t which = 1; which < live->channels_count; which++)
        if (live->channels[which].strength->loud > loudest->loud)
            loudest = live->channels[which].strength;
    const double programme = loudest->programme, sound_ticks = loudest->sound_ticks;
    for (size_t which = 0; which < live->channels_count; which++) {
        live->channels[which].strength->programme = programme;
        live->channels[which].strength->sound_ticks = sound_ticks;
    }
}

void live_process(Live *live, Sound sound, size_t frames, double *vibration)
{
    const Settings *s = &live->settings;
    live->delivered += frames;
    while (frames) {
        const size_t same = up_to_onset(live, sound, frames);
        const size_t room = s->tick_frames - live->filled, part = same < room ? same : room;
        const int silent = note_silence(live, sound, part);
        for (size_t which = 0; which < live->channels_count; which++) {
            Sound input = sound;
            if (live->per_channel) {
                input.at += (ptrdiff_t)which * sound.channel_bytes;
                input.channels = 1;
            }
            Channel *channel = &live->channels[which];
            collect(live, channel, input, part, silent);
            deliver(channel, live->filled, part, vibration + which, live->channels_count);
            if (s->begin_fade.length)
                begin(s, channel->begun, vibration + which, part, live->channels_count);
        }
        sound.at += (ptrdiff_t)part * sound.frame_bytes;
        vibration += part * live->channels_count;
        frames -= part;
        live->filled += part;
        live->log.frame += part;
        live->oldest = (live->oldest + part) % s->window_frames;
        if (live->filled == s->tick_frames) {
            live->filled = 0;
            if (live->tick + 1 == s->ticks) {
                live->display.count = 0;
                live->display.hops++;
            }
            for (size_t which = 0; which < live->channels_count; which++)
                advance(live, &live->channels[which]);
            live->tick = (live->tick + 1) % s->ticks;
            if (loudness_is_on(s))
                share_programme(live);
        }
    }
}
