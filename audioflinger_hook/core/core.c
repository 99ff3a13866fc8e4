/* The core: a transform, drives of actuators, or both. */

#include "core_parts.h"

/* Wanted words, which another thread may be writing, are loaded once. */
INLINED double load_number(const double *place) { return *(const volatile double *)place; }

INLINED uint64_t load_count(const uint64_t *place) { return *(const volatile uint64_t *)place; }

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
    const double wanted_gain = load_number(&controls->gain);
    const double wanted_delay = load_number(&controls->delay_frames);
    const uint64_t source = load_count(&controls->source);
    const double gain = fabs(wanted_gain) <= 1.0 ? wanted_gain : 0.0;
    const double delay =
        wanted_delay >= 0.0 ? smaller(wanted_delay, (double)info->delay_frames_max) : 0.0;
    const TapPoint tap = {source < info->vibrations ? (size_t)source : 0,
                          info->drive_latency_frames - own + (size_t)(delay + 0.5)};
    const int audible = load_count(&controls->audible) != 0;
    Actuator *actuator = &core->actuators[which];
    if (core->is_opened && load_count(&controls->restores))
        actuator_set_safety(actuator, &controls->safety);
    if (core->is_fresh)
        actuator_begin(actuator, tap, gain, audible);
    else
        actuator_change(actuator, tap, gain, audible);
}

/* Write what the latest hop vibrates, once for each hop. */
static void report_partials(Core *core, CoreReadings *readings)
{
    const DisplayPartials *display = &core->live.display;
    if (display->hops == core->hops)
        return;
    core->hops = display->hops;
    const uint64_t sequence = readings->sequence & ~UINT64_C(1); /* odd: a host ended while it wrote */
    STORE(readings->sequence, sequence + 1);
    __atomic_thread_fence(__ATOMIC_RELEASE);
    STORE(readings->partials_count, (uint64_t)display->count);
    for (size_t one = 0; one < display->count; one++) {
        STORE(readings->partials[one][0], display->audio_hz[one]);
        STORE(readings->partials[one][1], display->hz[one]);
        STORE(readings->partials[one][2], display->amplitude[one]);
    }
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

/* Measure the first channels of sound. */
static void measure(CoreLevel *levels, CoreSound sound, size_t channels, size_t frames, double samplerate)
{
    for (size_t channel = 0; channel < channels && channel < CORE_CHANNELS; channel++)
        sound_measure(&levels[channel], sound, channel, frames, samplerate);
}

/* Turn sound of any length into vibration, (frames, vibrations). */
static void transform(Core *core, CoreSound sound, double *vibration, size_t frames)
{
    const CoreInfo *info = &core->design.info;
    const size_t inputs = info->inputs, vibrations = info->vibrations;
    for (size_t done = 0; core->design.weights && done < frames;) {
        const size_t left = frames - done, part = left < PIECE_FRAMES ? left : PIECE_FRAMES;
        sound_mix(core, later(sound, done), part);
        live_process(&core->live, sound_of(interleaved(core->mixed, vibrations), vibrations), part,
                     vibration + done * vibrations);
        done += part;
    }
    if (core->design.has_transform && !core->design.weights)
        live_process(&core->live, sound_of(sound, inputs), frames, vibration);
    for (size_t frame = 0; !core->design.has_transform && frame < frames; frame++)
        for (size_t channel = 0; channel < vibrations; channel++)
            vibration[frame * vibrations + channel] = sample_at(sound, frame, channel);
}

/* Process frames that the buffers have room for. */
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
        history_add(&core->history, core->vibration, frames);
    else
        for (size_t at = 0; at < frames * vibrations; at++)
            out[at] = (float)core->vibration[at];
    const CoreSound signal = {out, (ptrdiff_t)(actuators * sizeof(float)), sizeof(float), 0};
    for (size_t which = 0; which < actuators; which++) {
        actuator_process(&core->actuators[which], &core->history, out + which, actuators, frames);
        if (readings)
            sound_measure(&readings->actuators[which].level, signal, which, frames, samplerate);
    }
}

/* Write the counts of a call. */
static void report(Core *core, size_t frames, CoreReadings *readings)
{
    core->frames += frames;
    if (!readings)
        return;
    for (size_t which = 0; which < core->design.info.actuators; which++)
        report_actuator(&core->actuators[which], &readings->actuators[which]);
    STORE(readings->replaced, core->replaced + core->live.replaced);
    STORE(readings->limited, core->live.limited);
    STORE(readings->frames, core->frames);
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
    const uint64_t day = load_count(&controls->day);
    for (size_t which = 0; which < info->actuators && !core->is_opened && day != core->day; which++)
        actuator_begin_day(&core->actuators[which]);
    core->day = day;
    const double wanted = load_number(&controls->sound_gain);
    const double gain = wanted >= 0.0 && wanted < INFINITY ? wanted : 1.0;
    const double before = core->is_opened ? gain : core->sound_gain;
    core->is_fresh = core->is_opened = 0;
    core->sound_gain = gain;
    for (size_t done = 0; done < frames;) {
        const size_t left = frames - done, part = left < PIECE_FRAMES ? left : PIECE_FRAMES;
        CoreSound piece = later(sound, done);
        if (gain != 1.0 || before != 1.0) {
            sound_scale(core, piece, part, before, gain, (double)done, (double)frames);
            piece = interleaved(core->sound, info->inputs);
        }
        process_piece(core, piece, out + done * outputs, part, readings);
        done += part;
    }
    report(core, frames, readings);
}
