/* Processes sound: transform, actuators, levels and readings. */

#include "core_parts.h"
#include "../transform/native/exact.h"

#define RMS_TIME_S 0.3
#define PEAK_FALL_DB_PER_S 20.0
#define INAUDIBLE 2.8e-8 /* -151 dBFS; a lower peak or r.m.s. becomes 0, which avoids denormal numbers */

/* Find the peak and the sum of squares of the finite samples. Four independent sums are faster than one. */
#define GATHER(type)                                                                               \
    for (size_t frame = 0; frame < frames; frame++, at += sound.frame_bytes) {                     \
        const double size = fabs((double)*(const type *)(const void *)at);                         \
        const double sample = size < INFINITY ? size : 0.0;                                        \
        loudest[frame % 4] = larger(sample, loudest[frame % 4]);                                   \
        sums[frame % 4] += sample * sample;                                                        \
    }

/* Update a channel's peak and mean square (see CoreLevel) with new frames. */
static void sound_measure(CoreLevel *level, CoreSound sound, size_t channel, size_t frames, double samplerate)
{
    const char *at = (const char *)sound.at + (ptrdiff_t)channel * sound.channel_bytes;
    double loudest[4] = {0.0}, sums[4] = {0.0};
    if (sound.is_double)
        GATHER(double)
    else
        GATHER(float)
    const double sum = (sums[0] + sums[1]) + (sums[2] + sums[3]);
    const double seconds = (double)frames / samplerate, keep = exact_exp(-seconds / RMS_TIME_S);
    const double held = level->peak * exact_amplitude(-seconds * PEAK_FALL_DB_PER_S);
    const double most = larger(larger(loudest[0], loudest[1]), larger(loudest[2], loudest[3]));
    const double peak = larger(most, held);
    const double square = keep * level->mean_square + (1.0 - keep) * sum / (double)frames;
    level->peak = peak > INAUDIBLE ? peak : 0.0;
    level->mean_square = square > INAUDIBLE * INAUDIBLE && square < INFINITY ? square : 0.0;
}

/* Write the sound times a gain to core->sound. During a call of core_process, the gain changes linearly from
 * `from` to `to`. first: index of the sound's first frame, counted from the start of the call. If `from` or `to`
 * exceeds 1, clip to ±1, except for invalid samples (NaN or |sample| > magnitude_max), which the transform
 * replaces. */
static void sound_scale(Core *core, CoreSound sound, size_t frames, double from, double to, double first,
                        double call_frames)
{
    const size_t inputs = core->design.info.inputs;
    const int amplifies = from > 1.0 || to > 1.0;
    const CoreDesign *design = &core->design;
    const double usable = design->has_transform ? design->settings.magnitude_max : INFINITY;
    double *out = core->sound;
    for (size_t frame = 0; frame < frames; frame++) {
        const double share = (first + (double)frame + 1.0) / call_frames;
        const double gain = from + (to - from) * share;
        for (size_t channel = 0; channel < inputs; channel++) {
            const double given = sample_at(sound, frame, channel);
            double sample = gain * given;
            if (amplifies && fabs(given) <= usable)
                sample = sample > 1.0 ? 1.0 : sample < -1.0 ? -1.0 : sample;
            *out++ = sample;
        }
    }
}

/* Mix the sound's channels with each source's weights; write core->mixed, (frames, sources). */
static void sound_mix(Core *core, CoreSound sound, size_t frames)
{
    const size_t inputs = core->design.info.inputs, sources = core->design.info.vibrations;
    const Settings *settings = &core->design.settings;
    double *mean = core->mixed + PIECE_FRAMES * sources, *side = mean + PIECE_FRAMES;
    for (size_t source = 0; source < sources; source++) {
        const double *weights = core->design.weights + 2 * source * inputs;
        const size_t replaced =
            input_mix(settings, &core->powers[source], sound, inputs, weights, frames, mean, side);
        core->state->replaced += source == 0 ? replaced : 0;
        for (size_t frame = 0; frame < frames; frame++)
            core->mixed[frame * sources + source] = mean[frame];
    }
}

/* Read a control exactly once, since another thread may change it. */
#define LOAD(place) (*(const volatile __typeof__(place) *)&(place))

#define STORE(place, value)                                                                        \
    do {                                                                                           \
        __typeof__(place) word_ = (value);                                                         \
        __atomic_store(&(place), &word_, __ATOMIC_RELAXED);                                        \
    } while (0)

static void take_controls(Core *core, size_t which, const ActuatorControls *controls)
{
    const CoreInfo *info = &core->design.info;
    const size_t drive = core->design.drive_of[which];
    const size_t own = drive < DRIVES_MAX ? drive_latency_frames(&core->drives[drive]) : 0;
    const double wanted_gain = LOAD(controls->gain);
    const double wanted_delay = LOAD(controls->delay_frames);
    const uint64_t source = LOAD(controls->source);
    const double gain = fabs(wanted_gain) <= 1.0 ? wanted_gain : 0.0;
    const double delay =
        wanted_delay >= 0.0 ? smaller(wanted_delay, (double)info->delay_frames_max) : 0.0;
    const TapPoint tap = {source < info->vibrations ? (size_t)source : 0,
                          info->drive_latency_frames - own + (size_t)(delay + 0.5)};
    const int audible = LOAD(controls->audible) != 0;
    Actuator *actuator = &core->actuators[which];
    const uint64_t restores = LOAD(controls->restores);
    if (core->state->is_opened && restores)
        actuator_set_safety(actuator, &controls->safety);
    else if (restores == core->state->frames + 1)
        actuator_set_temperatures(actuator, &controls->safety);
    actuator_set(actuator, tap, gain, audible, core->state->is_fresh);
}

/* Write the partials of the latest hop to the readings, unless an earlier call wrote them. */
static void report_partials(Core *core, CoreReadings *readings)
{
    const DisplayPartials *display = &core->live.display;
    if (display->hops == core->hops)
        return;
    core->hops = display->hops;
    const uint64_t sequence = readings->sequence & ~UINT64_C(1); /* clears the flag of an unfinished write */
    STORE(readings->sequence, sequence + 1);
    __atomic_thread_fence(__ATOMIC_RELEASE);
    STORE(readings->partials_count, (uint64_t)display->count);
    for (size_t one = 0; one < display->count; one++)
        for (size_t column = 0; column < 3; column++)
            STORE(readings->partials[one][column], display->rows[one][column]);
    __atomic_thread_fence(__ATOMIC_RELEASE);
    STORE(readings->sequence, sequence + 2);
}

static void report_actuator(const Actuator *actuator, ActuatorReadings *readings)
{
    ActuatorReadings now = {.level = readings->level};
    actuator_report(actuator, &now);
    uint64_t words[sizeof now / sizeof(uint64_t)], *places = (uint64_t *)(void *)readings;
    memcpy(words, &now, sizeof now);
    for (size_t word = 0; word < sizeof now / sizeof(uint64_t); word++)
        STORE(places[word], words[word]);
}

static void measure(CoreLevel *levels, CoreSound sound, size_t channels, size_t frames, double samplerate)
{
    for (size_t channel = 0; channel < channels && channel < CORE_CHANNELS; channel++)
        sound_measure(&levels[channel], sound, channel, frames, samplerate);
}

/* Compute the vibration, (frames, vibrations), from sound of any length. */
static void transform(Core *core, CoreSound sound, double *vibration, size_t frames)
{
    const CoreInfo *info = &core->design.info;
    const size_t inputs = info->inputs, vibrations = info->vibrations;
    for (size_t done = 0; core->design.weights && done < frames;) {
        const size_t left = frames - done, part = left < PIECE_FRAMES ? left : PIECE_FRAMES;
        sound_mix(core, sound_from(sound, done, 0), part);
        live_process(&core->live, interleaved(core->mixed, vibrations), vibrations, part,
                     vibration + done * vibrations);
        done += part;
    }
    if (core->design.has_transform && !core->design.weights)
        live_process(&core->live, sound, inputs, frames, vibration);
    for (size_t frame = 0; !core->design.has_transform && frame < frames; frame++)
        for (size_t channel = 0; channel < vibrations; channel++)
            vibration[frame * vibrations + channel] = sample_at(sound, frame, channel);
}

static void process_piece(Core *core, CoreSound sound, float *out, size_t frames,
                          CoreReadings *readings)
{
    const CoreInfo *info = &core->design.info;
    const size_t vibrations = info->vibrations, actuators = info->actuators;
    const double samplerate = (double)info->samplerate;
    transform(core, sound, core->vibration, frames);
    if (readings) {
        const CoreSound vibration = interleaved(core->vibration, vibrations);
        measure(readings->sound, sound, info->inputs, frames, samplerate);
        measure(readings->vibration, vibration, vibrations, frames, samplerate);
    }
    if (actuators)
        history_add(core->history, core->vibration, frames);
    else
        for (size_t at = 0; at < frames * vibrations; at++)
            out[at] = (float)core->vibration[at];
    const CoreSound signal = {out, (ptrdiff_t)(actuators * sizeof(float)), sizeof(float), 0};
    for (size_t which = 0; which < actuators; which++) {
        actuator_process(&core->actuators[which], core->history, out + which, actuators, frames);
        if (readings)
            sound_measure(&readings->actuators[which].level, signal, which, frames, samplerate);
    }
}

/* Count the frames of a call. Unless `readings` is NULL, write counts, actuators' readings and partials. */
static void report(Core *core, size_t frames, CoreReadings *readings)
{
    core->state->frames += frames;
    if (!readings)
        return;
    for (size_t which = 0; which < core->design.info.actuators; which++)
        report_actuator(&core->actuators[which], &readings->actuators[which]);
    const LiveState *live = core->live.state; /* NULL without a transform */
    STORE(readings->replaced, core->state->replaced + (live ? live->replaced : 0));
    STORE(readings->limited, live ? live->limited : 0);
    STORE(readings->frames, core->state->frames);
    if (core->design.has_transform)
        report_partials(core, readings);
}

void core_vibrate(Core *core, CoreSound sound, double *vibration, size_t frames, CoreReadings *readings)
{
    if (!frames)
        return;
    transform(core, sound, vibration, frames);
    report(core, frames, readings);
}

void core_process(Core *core, const CoreControls *controls, CoreSound sound, float *out, size_t frames,
                  CoreReadings *readings)
{
    const CoreInfo *info = &core->design.info;
    const size_t outputs = info->actuators ? info->actuators : info->vibrations;
    if (!frames)
        return;
    for (size_t which = 0; which < info->actuators; which++)
        take_controls(core, which, &controls->actuators[which]);
    const uint64_t day = LOAD(controls->day);
    for (size_t which = 0; which < info->actuators && !core->state->is_opened && day != core->state->day; which++)
        actuator_begin_day(&core->actuators[which]);
    core->state->day = day;
    const double wanted = LOAD(controls->sound_gain);
    const double gain = wanted >= 0.0 && wanted < INFINITY ? wanted : 1.0;
    const double before = core->state->is_opened ? gain : core->state->sound_gain;
    core->state->is_fresh = core->state->is_opened = 0;
    core->state->sound_gain = gain;
    for (size_t done = 0; done < frames;) {
        const size_t left = frames - done, part = left < PIECE_FRAMES ? left : PIECE_FRAMES;
        CoreSound piece = sound_from(sound, done, 0);
        if (gain != 1.0 || before != 1.0) {
            sound_scale(core, piece, part, before, gain, (double)done, (double)frames);
            piece = interleaved(core->sound, info->inputs);
        }
        process_piece(core, piece, out + done * outputs, part, readings);
        done += part;
    }
    report(core, frames, readings);
}

size_t core_glides_max(const Core *core, size_t frames)
{
    const Settings *s = &core->live.settings;
    if (!core->design.has_transform)
        return 0;
    const size_t of_hops = (frames / s->hop_frames + 2) * tracking_slots(s);
    const size_t tracked = loudness_is_on(s) ? tracking_slots(s) : 0;
    const size_t of_tick = tracked + s->onset_partials_max;
    const size_t of_ticks = (frames / s->tick_frames + 2) * of_tick;
    return core->live.channels_count * (of_hops + of_ticks);
}

size_t core_record(Core *core, CoreGlide *rows, size_t room)
{
    GlideLog *log = &core->live.log;
    const size_t written = log->count;
    *log = (GlideLog){log->rows ? log->frame : 0, 0, room, rows};
    return written;
}
