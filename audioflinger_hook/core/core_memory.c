/* Memory of a core: layout, creation, reset, and saved state. */

#include "core_parts.h"

const uint64_t core_sizes[6] = {sizeof(CoreInfo),         sizeof(CoreSound),
                                sizeof(CoreControls),     sizeof(ActuatorControls),
                                sizeof(CoreReadings),     sizeof(ActuatorReadings)};

/* Allocate the stream's state. If arena->base is NULL, only count bytes. In the allocated structures, only
 * pointers, lengths and sample rates are set. */
static void layout_state(Core *core, Arena *arena)
{
    const CoreInfo *info = &core->design.info;
    const size_t vibrations = info->vibrations, mixes = core->design.weights ? vibrations : 0;
    const size_t frames =
        info->actuators ? info->delay_frames_max + info->drive_latency_frames + PIECE_FRAMES : 0;
    core->memory = *arena;
    core->state = arena_alloc(arena, 1, sizeof(CoreState));
    core->powers = arena_alloc(arena, mixes, sizeof(DownmixState));
    if (core->design.has_transform)
        live_layout_state(&core->live, arena);
    core->history = arena_alloc(arena, 1, sizeof(History));
    float *samples = arena_alloc(arena, vibrations * frames, sizeof(float));
    if (core->history)
        *core->history = (History){samples, vibrations, frames, core->history->next};
    core->actuators = arena_alloc(arena, info->actuators, sizeof(Actuator));
    for (size_t which = 0; which < info->actuators; which++) {
        const size_t drive = core->design.drive_of[which];
        actuator_layout(core->actuators ? core->actuators + which : NULL,
                        drive < DRIVES_MAX ? core->drives + drive : NULL, (double)info->samplerate,
                        arena);
    }
    core->memory_bytes = arena->used - core->memory.used;
}

/* Return a 64-bit hash: FNV-1a over words of 8 bytes, without the bytes after the last whole word. */
static uint64_t fnv_1a(const void *memory, size_t bytes)
{
    const char *place = memory;
    uint64_t sum = 0xcbf29ce484222325u, word;
    for (size_t at = 0; at + sizeof word <= bytes; at += sizeof word) {
        memcpy(&word, place + at, sizeof word);
        sum = (sum ^ word) * 0x100000001b3u;
    }
    return sum;
}

/* Allocate all memory. If arena->base is NULL, only count bytes. Return 0 if an FFT length has a prime
 * factor above 5. */
static int layout(Core *core, Arena *arena)
{
    const CoreInfo *info = &core->design.info;
    const size_t vibrations = info->vibrations, mixes = core->design.weights ? vibrations : 0;
    core->sound = arena_alloc(arena, PIECE_FRAMES * info->inputs, sizeof(double));
    core->mixed = arena_alloc(arena, mixes ? PIECE_FRAMES * (mixes + 2) : 0, sizeof(double));
    core->vibration = arena_alloc(arena, PIECE_FRAMES * vibrations, sizeof(double));
    if (core->design.has_transform) {
        const int per_channel = mixes || core->design.per_channel;
        const size_t channels = mixes ? mixes : info->inputs;
        if (!live_open(&core->live, &core->design.settings, channels, per_channel, arena))
            return 0;
    }
    layout_state(core, arena);
    return 1;
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
        misfit = core.live.short_fft.length ? "short_length: has other factors than 2, 3 and 5"
                                            : "fft_length: has other factors than 2, 3 and 5";
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
    core->state->is_opened = 1;
    core->state->sound_gain = 1.0;
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
    memset(core->history->samples, 0, info->vibrations * core->history->frames * sizeof(float));
    core->history->next = 0;
    for (size_t which = 0; which < info->actuators; which++)
        actuator_reset(&core->actuators[which], doses_too);
    core->state->is_fresh = 1;
}

typedef struct {
    uint64_t fingerprint; /* hash of the design */
    uint64_t checksum;    /* hash of the bytes after this header */
} StateHeader;

size_t core_state(Core *core, void *state, size_t room)
{
    const size_t bytes = sizeof(StateHeader) + core->memory_bytes;
    char *image = (char *)state + sizeof(StateHeader);
    if (room < bytes)
        return bytes;
    Arena arena = core->memory;
    memcpy(image, arena_whole(arena, core->memory_bytes), core->memory_bytes);
    layout_state(core, &arena);
    const StateHeader header = {core->fingerprint, fnv_1a(image, core->memory_bytes)};
    memcpy(state, &header, sizeof header);
    return bytes;
}

int core_set_state(Core *core, const void *state, size_t bytes)
{
    StateHeader header = {0, 0};
    const char *image = (const char *)state + sizeof header;
    if (bytes == sizeof header + core->memory_bytes)
        memcpy(&header, state, sizeof header);
    if (header.fingerprint != core->fingerprint || header.checksum != fnv_1a(image, core->memory_bytes)) {
        core_reset(core, 0);
        return 0;
    }
    Arena arena = core->memory;
    memcpy(arena_whole(arena, core->memory_bytes), image, core->memory_bytes);
    layout_state(core, &arena); /* replaces the pointers, which are those of the core that saved the state */
    return 1;
}
