/* Haptic Cushion's core: sound in, the signals of actuators out.
 *
 * Pure: no I/O, no clock, no thread, no lock, no allocation; memory and design belong to the host. One
 * thread calls core_process; controls and readings are words that any thread may store and load. The
 * same design and the same sound give the same bytes in every host and on every machine, however the
 * sound is split into calls. audioflinger_hook/core/compiled_core.py says the same in Python. */

#pragma once

#include <stddef.h>
#include <stdint.h>

enum { CORE_CHANNELS = 8, CORE_ACTUATORS = 64, CORE_PARTIALS = 16 };

typedef struct Core Core;

/* What a design is for. It has a transform, drives of actuators, or both; a stage that it lacks passes
 * everything on. */
typedef struct {
    uint32_t samplerate;
    uint32_t inputs;     /* channels of sound; of vibration if there is no transform */
    uint32_t vibrations; /* channels after the transform */
    uint32_t actuators;  /* 0: the vibrations are the outputs */
    uint32_t latency_frames, tonal_latency_frames; /* of the transform */
    uint32_t drive_latency_frames;                 /* of the drives, without the actuators' delays */
    uint32_t delay_frames_max;                     /* longest delay of an actuator */
    uint64_t memory_bytes;
} CoreInfo;

/* Samples in memory, at any distances. */
typedef struct {
    const void *at;
    ptrdiff_t frame_bytes, channel_bytes;
    int is_double; /* else float */
} CoreSound;

/* Sums of a day's weighted acceleration, integrated over time. */
typedef struct {
    double time_s, squares, fourths, above;
} CoreDose;

/* What must outlive a process. Temperatures in degrees Celsius. */
typedef struct {
    double coil_c, magnet_c;
    CoreDose dose;
} ActuatorSafety;

/* Wanted of one actuator; every change fades. */
typedef struct {
    double gain;         /* -1 to 1: level and polarity */
    double delay_frames; /* behind the other actuators */
    uint64_t source;     /* number of the vibration */
    uint64_t audible;    /* 0: faded out */
    uint64_t restores;   /* 1: begin with `safety`; read at the first call after core_open */
    ActuatorSafety safety;
} ActuatorControls;

typedef struct {
    double sound_gain; /* factor on the sound, which undoes the listener's volume */
    uint64_t day;      /* another number begins a new day's dose */
    ActuatorControls actuators[CORE_ACTUATORS];
} CoreControls;

typedef struct {
    double peak, mean_square; /* of the last moments */
} CoreLevel;

typedef struct {
    CoreLevel level;
    double audible; /* factor of the fade, 0 to 1 */
    double gain, least_gain, exposure_gain; /* of the protection, and of the dose's cap */
    double excursion_m, coil_c, magnet_c;
    CoreDose dose;
    double running_m_s2;                    /* of the last second */
    double undamped_squares; /* as squares, without damping and protection */
    uint64_t blocks, limited_blocks, infeasible_blocks, replaced;
    uint64_t limited_by; /* LimitedBy of drive/protection.h */
} ActuatorReadings;

/* The only counts and levels there are. */
typedef struct {
    uint64_t frames, replaced, limited; /* limited: samples that were limited to full scale */
    CoreLevel sound[CORE_CHANNELS], vibration[CORE_CHANNELS];
    uint64_t sequence; /* odd while the partials are written */
    uint64_t partials_count;
    double partials[CORE_PARTIALS][3]; /* Hz of the sound, Hz of vibration, amplitude */
    ActuatorReadings actuators[CORE_ACTUATORS];
} CoreReadings;

#define CORE_API __attribute__((visibility("default")))

/* Sizes of the structures above, for hosts in other languages: CoreInfo, CoreSound, CoreControls,
 * ActuatorControls, CoreReadings, ActuatorReadings. */
CORE_API extern const uint64_t core_sizes[6];

/* Check a design, whose bytes lie at a multiple of 8. Return NULL and what it is for, or what is wrong. */
CORE_API const char *core_check(const void *design, size_t bytes, CoreInfo *info);

/* Make a core in memory_bytes of memory at a multiple of 16, at rest; NULL if core_check refuses the
 * design. Design and memory stay in place while it is used. */
CORE_API Core *core_open(const void *design, size_t bytes, void *memory);

/* Return to rest, with the controls of the next call. Counts, temperatures and doses stay unless asked. */
CORE_API void core_reset(Core *core, int doses_too);

/* Take frames of sound and write as many of each output, (frames, outputs), interleaved. */
CORE_API void core_process(Core *core, const CoreControls *controls, CoreSound sound, float *out,
                           size_t frames, CoreReadings *readings);

/* The transform alone: write the vibration before it is rounded, (frames, vibrations). No levels. */
CORE_API void core_vibrate(Core *core, CoreSound sound, double *vibration, size_t frames,
                           CoreReadings *readings);

/* Copy what changes as a stream goes on, if there is room; return its bytes. */
CORE_API size_t core_state(const Core *core, void *state, size_t room);

/* Continue from such a state of a core with the same design; return 0 and reset if it is none. */
CORE_API int core_set_state(Core *core, const void *state, size_t bytes);

/* One partial in one hop or tick, for those who write down what vibrates. Only numbers. */
typedef struct {
    double frame; /* the first, counted since the recording began */
    double frames, channel, slot;
    double start_hz, end_hz, start_amplitude, end_amplitude, start_phase;
} CoreGlide;

/* The most glides that so many frames can have. */
CORE_API size_t core_glides_max(const Core *core, size_t frames);

/* Record glides into the host's rows from now on; NULL ends the recording. Return how many were written
 * into the rows of before. */
CORE_API size_t core_record(Core *core, CoreGlide *rows, size_t room);
