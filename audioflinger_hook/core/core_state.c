/* What of a core goes on elsewhere: its state, and the log of its glides. */

#include "core_parts.h"

/* What changes as a stream goes on, beside the numbers of channels, mixes and drives. */
typedef struct {
    uint64_t filled, tick, oldest, silent, replaced, mix_replaced, limited, delivered;
    uint64_t frames, day, is_fresh, is_opened;
    double sound_gain;
} Counters;

/* What goes before the memory of history and actuators. */
typedef struct {
    uint64_t fingerprint; /* of the design */
    uint64_t checksum;    /* of that memory */
    uint64_t next;        /* of the history */
} Driven;

/* Copy the arena's memory by words, also what lies between two parts of it; the state may be anywhere. */
__attribute__((no_sanitize("address"))) static void copy_out(char *state, const void *memory, size_t bytes)
{
    const volatile uint64_t *words = memory;
    for (size_t at = 0; at < bytes / sizeof *words; at++) {
        const uint64_t word = words[at];
        memcpy(state + at * sizeof word, &word, sizeof word);
    }
}

__attribute__((no_sanitize("address"))) static void copy_in(void *memory, const char *state, size_t bytes)
{
    volatile uint64_t *words = memory;
    for (size_t at = 0; at < bytes / sizeof *words; at++) {
        uint64_t word;
        memcpy(&word, state + at * sizeof word, sizeof word);
        words[at] = word;
    }
}

static size_t mix_bytes(const Core *core)
{
    return core->design.weights ? core->design.info.vibrations * sizeof(DownmixState) : 0;
}

static size_t channels_bytes(const Core *core)
{
    return core->design.has_transform ? core->live.state_length * sizeof(double) : 0;
}

static size_t driven_bytes(const Core *core)
{
    return core->design.info.actuators ? sizeof(Driven) + core->driven_bytes : 0;
}

static void *driven_memory(const Core *core) { return core->driven.base + core->driven.used; }

static Counters counters_of(const Core *core)
{
    const Live *live = &core->live;
    return (Counters){live->filled,   live->tick,     live->oldest,   live->silent,    live->replaced,
                      core->replaced, live->limited,  live->delivered, core->frames,   core->day,
                      (uint64_t)core->is_fresh, (uint64_t)core->is_opened, core->sound_gain};
}

size_t core_state(const Core *core, void *state, size_t room)
{
    const size_t numbers = channels_bytes(core), mixes = mix_bytes(core);
    const size_t bytes = sizeof(Counters) + numbers + mixes + driven_bytes(core);
    const Counters counters = counters_of(core);
    char *place = state;
    if (room < bytes)
        return bytes;
    memcpy(place, &counters, sizeof counters);
    place += sizeof counters;
    if (numbers)
        memcpy(place, core->live.state, numbers);
    if (mixes)
        memcpy(place + numbers, core->powers, mixes);
    place += numbers + mixes;
    if (core->design.info.actuators) {
        char *image = place + sizeof(Driven);
        copy_out(image, driven_memory(core), core->driven_bytes);
        const Driven driven = {core->fingerprint, fnv_1a(image, core->driven_bytes), core->history.next};
        memcpy(place, &driven, sizeof driven);
    }
    return bytes;
}

/* Whether a core of the same design wrote this. */
static int is_driven(const Core *core, const char *place)
{
    Driven driven;
    memcpy(&driven, place, sizeof driven);
    return driven.fingerprint == core->fingerprint && driven.next < core->history.frames &&
           driven.checksum == fnv_1a(place + sizeof driven, core->driven_bytes);
}

static void set_driven(Core *core, const char *place)
{
    Driven driven;
    Arena arena = core->driven;
    memcpy(&driven, place, sizeof driven);
    copy_in(driven_memory(core), place + sizeof driven, core->driven_bytes);
    core_layout_driven(core, &arena); /* the pointers were those of the other */
    core->history.next = (size_t)driven.next;
}

static int is_possible(const Core *core)
{
    int possible = !core->design.has_transform || live_state_is_valid(&core->live);
    for (size_t mix = 0; core->design.weights && mix < core->design.info.vibrations; mix++)
        possible = possible && downmix_is_possible(&core->powers[mix]);
    return possible && core->sound_gain >= 0.0 && core->sound_gain < INFINITY;
}

static void set_counters(Core *core, const Counters *counters)
{
    Live *live = &core->live;
    live->filled = (size_t)counters->filled;
    live->tick = (size_t)counters->tick;
    live->oldest = (size_t)counters->oldest;
    live->silent = (size_t)counters->silent;
    live->replaced = counters->replaced;
    core->replaced = counters->mix_replaced;
    live->limited = counters->limited;
    live->delivered = counters->delivered;
    core->frames = counters->frames;
    core->day = counters->day;
    core->is_fresh = counters->is_fresh != 0;
    core->is_opened = counters->is_opened != 0;
    core->sound_gain = counters->sound_gain;
}

int core_set_state(Core *core, const void *state, size_t bytes)
{
    Counters counters;
    const Counters before = counters_of(core);
    const char *place = (const char *)state + sizeof counters;
    const size_t numbers = channels_bytes(core), mixes = mix_bytes(core);
    const int drives = core->design.info.actuators > 0;
    if (bytes != core_state(core, NULL, 0) || (drives && !is_driven(core, place + numbers + mixes))) {
        core_reset(core, 0);
        return 0;
    }
    memcpy(&counters, state, sizeof counters);
    if (numbers)
        memcpy(core->live.state, place, numbers);
    if (mixes)
        memcpy(core->powers, place + numbers, mixes);
    set_counters(core, &counters);
    if (!is_possible(core)) {
        set_counters(core, &before);
        core_reset(core, 0);
        return 0;
    }
    if (drives)
        set_driven(core, place + numbers + mixes);
    return 1;
}

_Static_assert(sizeof(CoreGlide) == sizeof(GlideRow), "a glide is a row of the log");

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
    if (!log->on)
        log->frame = 0;
    log->on = rows != NULL;
    log->rows = (GlideRow *)(void *)rows;
    log->room = room;
    log->count = 0;
    return written;
}
