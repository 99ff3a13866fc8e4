/* A core in memory of the host: its layout, its beginning, its rest. */

#include "core_parts.h"

const uint64_t core_sizes[6] = {sizeof(CoreInfo),         sizeof(CoreSound),
                                sizeof(CoreControls),     sizeof(ActuatorControls),
                                sizeof(CoreReadings),     sizeof(ActuatorReadings)};

/* Return 0 where the transform's lengths do not fit its spectrum. */
static int layout(Core *core, Arena *arena)
{
    const CoreInfo *info = &core->design.info;
    const size_t vibrations = info->vibrations;
    const size_t mixes = core->design.weights ? vibrations : 0;
    core->sound = arena_alloc(arena, PIECE_FRAMES * info->inputs, sizeof(double));
    core->mixed = arena_alloc(arena, mixes ? PIECE_FRAMES * (mixes + 2) : 0, sizeof(double));
    core->powers = arena_alloc(arena, mixes, sizeof(DownmixState));
    core->vibration = arena_alloc(arena, PIECE_FRAMES * vibrations, sizeof(double));
    if (core->design.has_transform) {
        const int per_channel = mixes || core->design.per_channel;
        const size_t channels = mixes ? mixes : info->inputs;
        if (!live_open(&core->live, &core->design.settings, channels, per_channel, arena))
            return 0;
    }
    core->driven = *arena;
    core_layout_driven(core, arena);
    core->driven_bytes = arena->used - core->driven.used;
    return 1;
}

void core_layout_driven(Core *core, Arena *arena)
{
    const CoreInfo *info = &core->design.info;
    const size_t vibrations = info->vibrations, actuators = info->actuators;
    core->history.sources = vibrations;
    core->history.frames =
        actuators ? info->delay_frames_max + info->drive_latency_frames + PIECE_FRAMES : 0;
    core->history.samples = arena_alloc(arena, vibrations * core->history.frames, sizeof(float));
    core->actuators = arena_alloc(arena, actuators, sizeof(Actuator));
    for (size_t which = 0; which < actuators; which++) {
        const size_t drive = core->design.drive_of[which];
        actuator_layout(core->actuators ? core->actuators + which : NULL,
                        drive < DRIVES_MAX ? core->drives + drive : NULL, (double)info->samplerate,
                        arena);
    }
}

const char *core_check(const void *bytes, size_t size, CoreInfo *info)
{
    Core core = {0};
    DriveDesign drives[DRIVES_MAX];
    Arena arena = {NULL, 0};
    arena_alloc(&arena, 1, sizeof(Core));
    arena_alloc(&arena, DRIVES_MAX, sizeof(DriveDesign));
    const char *misfit = core_design_read(&core.design, drives, bytes, size);
    core.drives = drives;
    if (!misfit && !layout(&core, &arena))
        misfit = "fft_length: has other factors than 2, 3 and 5";
    if (misfit)
        return misfit;
    *info = core.design.info;
    info->memory_bytes = arena.used;
    return NULL;
}

Core *core_open(const void *bytes, size_t size, void *memory)
{
    CoreInfo info;
    if (core_check(bytes, size, &info))
        return NULL;
    memset(memory, 0, info.memory_bytes);
    Arena arena = {memory, 0};
    Core *core = arena_alloc(&arena, 1, sizeof(Core));
    core->drives = arena_alloc(&arena, DRIVES_MAX, sizeof(DriveDesign));
    core_design_read(&core->design, core->drives, bytes, size);
    layout(core, &arena);
    core->fingerprint = fnv_1a(bytes, size);
    core->is_opened = 1;
    core->sound_gain = 1.0;
    core_reset(core, 1);
    return core;
}

void core_reset(Core *core, int doses_too)
{
    const CoreInfo *info = &core->design.info;
    if (core->design.has_transform)
        live_reset(&core->live);
    if (core->design.weights)
        memset(core->powers, 0, info->vibrations * sizeof(DownmixState));
    memset(core->history.samples, 0, info->vibrations * core->history.frames * sizeof(float));
    core->history.next = 0;
    for (size_t which = 0; which < info->actuators; which++)
        actuator_reset(&core->actuators[which], doses_too);
    core->is_fresh = 1;
}
