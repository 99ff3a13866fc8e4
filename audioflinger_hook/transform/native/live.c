/* The live form's hops and ticks.
 *
 * Frames are band-passed as they come, into a ring that holds one window. When a tick is full, the
 * onsets in it are looked for, and where a hop is full as well its window is analysed. The tick's
 * vibration is computed then, and delivered frame by frame as the next tick comes in. A block only
 * decides when that happens, so any split of a stream gives the same bytes.
 */

#include "live.h"

#include "common.h"
#include "levels.h"
#include "scaling.h"

/* ------------------------------------------------------------------------------------- analysis */

/* Put the window in order, the oldest frame first, and take it through the window function. */
SIMD_CLONES static void apply_window(const Live *live, const Voice *voice, double *restrict samples)
{
    const size_t frames = live->settings.window_frames, first = frames - live->oldest;
    const double *restrict window = live->settings.window.at;
    const double *restrict past = voice->past + live->oldest;
    for (size_t frame = 0; frame < first; frame++)
        samples[frame] = past[frame] * window[frame];
    past = voice->past;
    window += first;
    samples += first;
    for (size_t frame = 0; frame < frames - first; frame++)
        samples[frame] = past[frame] * window[frame];
}

/* Find the principal tones of the window; return how many, 0 where none vibrates. wanted: strength of
 * the vibration. */
static size_t analyse_window(Live *live, const Voice *voice, double wanted)
{
    const Settings *s = &live->settings;
    const Rule rule = {
        .bins = (int32_t)s->bins,
        .first = (int32_t)s->first_bin,
        .last = (int32_t)s->last_bin,
        .bin_hz = s->bin_hz,
        .threshold_hz = s->threshold_hz,
        .peak_span_min = s->peak_span_min,
        .side_lobe = s->side_lobe,
        .most = (int32_t)s->partials_max,
    };
    const size_t turned = s->image_turn.length / 2;
    const Window window = {
        .table = s->image_table.at,
        .entries = (int32_t)s->image_table.length,
        .cosine = s->image_turn.at,
        .sine = s->image_turn.at + turned,
        .low_bins = turned > NEIGHBOURS ? (int32_t)turned - NEIGHBOURS : 0,
        .first_sample = s->image_first,
        .weakest = s->weakest_image,
        .weakest_share = s->weakest_share,
    };
    const Spectrum spectrum = {live->real, live->imaginary, 1};
    apply_window(live, voice, live->windowed);
    fft_spectrum(&live->fft, live->windowed, s->bins, live->real, live->imaginary, live->fft_space);
    if (!(wanted > 0.0))
        return 0;
    return (size_t)principal(&rule, &window, spectrum, live->found, live->analysis_space);
}

/* -------------------------------------------------------------------------------------- one hop */

/* Publish the partials of a hop; of too many, the weakest are left out. wanted: strength. */
static void tell(Live *live, double wanted, size_t count)
{
    Told *told = &live->told;
    const double gain = loudness_is_on(&live->settings) ? levels_gain(live, wanted, count) : 1.0;
    for (size_t one = 0; one < count; one++) {
        size_t at = told->count;
        if (at < TOLD_MAX) {
            told->count++;
        } else {
            at = 0;
            for (size_t other = 1; other < TOLD_MAX; other++)
                if (told->amplitude[other] < told->amplitude[at])
                    at = other;
            if (gain * live->amplitude[one] <= told->amplitude[at])
                continue;
        }
        told->audio_hz[at] = live->found.audio_hz[one];
        told->hz[at] = live->hz[one];
        told->amplitude[at] = gain * live->amplitude[one];
    }
}

static void follow(Live *live, Voice *voice, Glides *glides, double wanted, size_t count)
{
    const Settings *s = &live->settings;
    const double left = tracking_holds(s, &voice->slots) ? levels_left_by_law(live, count) : 1.0;
    for (size_t one = 0; one < count; one++)
        live->hz[one] = felt_hz(s, live->found.audio_hz[one]);
    if (levels_set(live, voice, count))
        live->limited += s->hop_frames;
    tell(live, wanted, count);
    double total = 0.0;
    for (size_t one = 0; one < count; one++) {
        total += live->amplitude[one];
        live->amplitude[one] *= smoothing_gain(s, live->hz[one]);
    }
    const Partials partials = {live->found.audio_hz, live->hz, live->amplitude, count};
    const double room = loudness_is_on(s) ? INFINITY : larger(0.0, s->ceiling - total);
    tracking_follow(s, &voice->slots, glides, partials, room, left, &voice->onsets,
                    live->tracking_space);
}

static size_t number_of(const Live *live, const Voice *voice)
{
    return (size_t)(voice - live->voices);
}

/* Find the next hop of the partials. wanted: strength at its start. */
static void end_hop(Live *live, Voice *voice, double wanted)
{
    const Settings *s = &live->settings;
    const int followed = loudness_is_on(s);
    Glides *glides = followed ? &voice->oscillators.hop : &live->glides;
    double loudest = 0.0;
    for (size_t hop = 0; hop < s->hops_in_window; hop++)
        loudest = larger(voice->peaks[hop], loudest);
    memmove(voice->peaks, voice->peaks + 1, (s->hops_in_window - 1) * sizeof(double));
    voice->peaks[s->hops_in_window - 1] = 0.0;

    onset_partials_hand_over(s, voice->fresh, &voice->onsets, &voice->slots);
    size_t count = 0;
    const int audible = loudest >= s->silence;
    if (audible)
        count = analyse_window(live, voice, wanted);
    if (s->speech_db > 0.0 && audible)
        speech_hear(s, voice->speech, live->real, live->imaginary, live->speech_space);
    else if (s->speech_db > 0.0)
        speech_pause(s, voice->speech);
    if (count || tracking_holds(s, &voice->slots)) {
        follow(live, voice, glides, wanted, count);
        *voice->ringing = (double)s->ring_hops;
    } else if (tracking_sounds(s, &voice->slots)) {
        tracking_fade(s, &voice->slots, glides);
    } else {
        if (*voice->ringing > 0.0)
            *voice->ringing -= 1.0;
        tracking_rest(s, glides);
    }
    if (followed) {
        oscillators_begin_hop(s, &voice->oscillators);
        return;
    }
    const GlidePlace place = {number_of(live, voice), 0, tracking_slots(s), s->hop_frames};
    glide_log_add_all(&live->log, place, glides);
    synthesis_hop(s, glides, voice->hop);
}

/* -------------------------------------------------------------------------------------- one tick */

/* Look for an onset in the tick that is full; `newest` and the powers of its bins are known then. */
static int find_onset(Live *live, const Voice *voice)
{
    const Settings *s = &live->settings;
    const size_t count = s->short_frames;
    const size_t last = live->oldest ? live->oldest : s->window_frames;
    if (last >= count) {
        memcpy(live->newest, voice->past + last - count, count * sizeof(double));
    } else {
        const size_t wrapped = count - last;
        memcpy(live->newest, voice->past + s->window_frames - wrapped, wrapped * sizeof(double));
        memcpy(live->newest + wrapped, voice->past, last * sizeof(double));
    }
    return onsets_hear(s, &live->short_fft, &voice->onsets, live->newest, live->onset_space);
}

/* How strong the next tick vibrates at its end, by the loudness of the one that is full. */
static double find_strength(const Live *live, const Voice *voice)
{
    const Settings *s = &live->settings;
    double excitation[BANDS_MAX];
    band_powers_hear(s, &voice->powers, live->newest + (s->short_frames - s->tick_frames),
                     live->onset_space, excitation);
    const Heard heard = loudness_of(s, excitation);
    return strength_follow(s, voice->strength, &heard);
}

/* Write the next tick at the low rate: all partials by their own amplitudes. */
static void play_levels(Live *live, const Voice *voice, int fresh, int full)
{
    const Settings *s = &live->settings;
    const double *hop = voice->hop + (full ? 0 : (live->tick + 1) * s->tick_steps);
    memset(live->low_rate, 0, s->tick_steps * sizeof(double));
    if (fresh) {
        const GlidePlace place = {number_of(live, voice), tracking_slots(s), s->fresh_max, s->tick_frames};
        glide_log_add_all(&live->log, place, &live->fresh_glides);
        synthesis_add_fresh(s, &live->fresh_glides, live->low_rate);
    }
    for (size_t step = 0; step < s->tick_steps; step++)
        live->low_rate[step] += hop[step];
}

/* The same as strong as is wanted. */
static void play_strength(Live *live, const Voice *voice, int fresh, int full, double wanted)
{
    const Settings *s = &live->settings;
    const OscillatorTick now = {full ? 0 : live->tick + 1, fresh ? &live->fresh_glides : NULL, wanted,
                                &live->log, number_of(live, voice)};
    live->limited += s->decimation * oscillators_play(s, &voice->oscillators, now, live->low_rate,
                                                      live->oscillator_space);
}

/* Compute the vibration that follows the tick that is full now. */
static void advance(Live *live, Voice *voice)
{
    const Settings *s = &live->settings;
    const int followed = loudness_is_on(s), full = live->tick + 1 == s->ticks;
    const int onset = (s->find_onsets || followed) && find_onset(live, voice) && s->find_onsets;
    const OnsetSources told = {&voice->onsets, voice->speech};
    const double wanted = followed ? find_strength(live, voice) : 1.0;
    if (full)
        end_hop(live, voice, wanted);
    if (onset)
        onset_partials_bear(s, voice->fresh, told, &voice->slots,
                            full ? s->ticks : s->ticks - 1 - live->tick);
    const int fresh = onset_partials_sounds(s, voice->fresh);
    if (fresh) {
        *voice->ringing = (double)s->ring_hops;
        onset_partials_play(s, voice->fresh, told, &voice->slots, &live->fresh_glides);
    }
    if (followed)
        play_strength(live, voice, fresh, full, wanted);
    else if (*voice->ringing > 0.0)
        play_levels(live, voice, fresh, full);
    if (*voice->ringing > 0.0) {
        synthesis_play(s, live->low_rate, &voice->smoothing, voice->played, live->synthesis_space);
        live->limited += synthesis_keep_below_full_scale(s, voice->played);
    } else {
        /* What sleeps is exactly 0 and forgets its ringing. */
        smoothing_reset(s, &voice->smoothing);
        memset(voice->played, 0, s->tick_frames * sizeof(double));
    }
}

/* -------------------------------------------------------------------------------------- a block */

/* Take frames into a voice's window. silent: all of them are exactly 0. */
static void collect(Live *live, Voice *voice, Sound sound, size_t frames, int silent)
{
    const Settings *s = &live->settings;
    double loudest;
    if (silent) {
        if (live->mix_weights)
            downmix_rest(s, live->mix_powers, frames);
        loudest = input_band_pass_silence(s, voice->band, live->mono, frames);
    } else {
        const double *weights = live->mix_weights;
        live->replaced += input_mix(s, sound, weights, frames, live->mono, live->side);
        if (weights)
            downmix_restore(s, live->mix_powers, live->mono, live->side, frames);
        loudest = input_band_pass(s, voice->band, live->mono, frames);
    }
    double *of_hop = &voice->peaks[s->hops_in_window - 1];
    double *of_tick = &voice->onsets.peaks[s->short_ticks - 1];
    *of_hop = larger(loudest, *of_hop);
    *of_tick = larger(loudest, *of_tick);
    const double *from = live->mono;
    size_t at = live->oldest;
    while (frames) {
        const size_t room = s->window_frames - at, part = frames < room ? frames : room;
        memcpy(voice->past + at, from, part * sizeof(double));
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

static void deliver(const Voice *voice, size_t from, size_t frames, double *vibration, size_t apart)
{
    const double *played = voice->played + from;
    if (apart == 1)
        memcpy(vibration, played, frames * sizeof(double));
    else
        for (size_t frame = 0; frame < frames; frame++)
            vibration[frame * apart] = played[frame];
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
    for (size_t which = 0; which < live->voices_count; which++) {
        const Voice *voice = &live->voices[which];
        if (*voice->ringing > 0.0 || tracking_sounds(&live->settings, &voice->slots) ||
            !speech_is_at_rest(voice->speech))
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
        memset(live->mix_powers, 0, sizeof *live->mix_powers);
        for (size_t which = 0; which < live->voices_count; which++) {
            onsets_reset(&live->settings, &live->voices[which].onsets);
            live_rest(live, &live->voices[which]);
        }
    }
    return frames;
}

/* Let the programme be that of the loudest voice: what is softer on one side stays so. */
static void share_programme(Live *live)
{
    const Strength *loudest = live->voices[0].strength;
    for (size_t which = 1; which < live->voices_count; which++)
        if (live->voices[which].strength->loud > loudest->loud)
            loudest = live->voices[which].strength;
    const double programme = loudest->programme, heard = loudest->heard;
    for (size_t which = 0; which < live->voices_count; which++) {
        live->voices[which].strength->programme = programme;
        live->voices[which].strength->heard = heard;
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
        for (size_t which = 0; which < live->voices_count; which++) {
            Sound input = sound;
            if (live->each) {
                input.at += (ptrdiff_t)which * sound.channel_bytes;
                input.channels = 1;
            }
            Voice *voice = &live->voices[which];
            collect(live, voice, input, part, silent);
            deliver(voice, live->filled, part, vibration + which, live->voices_count);
            if (s->begin_fade.length)
                begin(s, voice->begun, vibration + which, part, live->voices_count);
        }
        sound.at += (ptrdiff_t)part * sound.frame_bytes;
        vibration += part * live->voices_count;
        frames -= part;
        live->filled += part;
        live->log.frame += part;
        live->oldest = (live->oldest + part) % s->window_frames;
        if (live->filled == s->tick_frames) {
            live->filled = 0;
            if (live->tick + 1 == s->ticks) {
                live->told.count = 0;
                live->told.hops++;
            }
            for (size_t which = 0; which < live->voices_count; which++)
                advance(live, &live->voices[which]);
            live->tick = (live->tick + 1) % s->ticks;
            if (loudness_is_on(s))
                share_programme(live);
        }
    }
}
