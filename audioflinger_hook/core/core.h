/* The core of Haptic Cushion computes the signals of actuators from sound. The core uses no I/O, clock,
 * thread, lock or allocation. The host, which calls the core, owns memory and design. Only one thread at a
 * time may call functions of a core. Any thread may write single values of controls and read single values of
 * readings. With constant controls, the same design and sound give the same output bytes in every host, on
 * every machine and for every block size. audioflinger_hook/core/compiled_core.py is the Python interface. */

#pragma once

#include <stddef.h>
#include <stdint.h>

enum { CORE_CHANNELS = 8, CORE_ACTUATORS = 64, CORE_PARTIALS = 16 };

typedef struct Core Core;

/* Properties of a design. A design has a transform (sound to vibration), actuators, or both. Without a
 * transform, the vibration is the sound. Without actuators, the output is the vibration. */
typedef struct {
    uint32_t samplerate;
    uint32_t inputs;     /* channels of sound, or of vibration if there is no transform */
    uint32_t vibrations; /* channels of vibration */
    uint32_t actuators;  /* 0: the vibrations are the outputs */
    uint32_t latency_frames, tonal_latency_frames; /* for onsets; for steady sound */
    uint32_t drive_latency_frames;                 /* largest delay of any protection */
    uint32_t delay_frames_max;                     /* largest allowed delay of an actuator */
    uint64_t memory_bytes;
} CoreInfo;

/* Samples in memory. frame_bytes, channel_bytes: distance to the next frame, to the next channel. */
typedef struct {
    const void *at;
    ptrdiff_t frame_bytes, channel_bytes;
    int is_double; /* 1: double; 0: float */
} CoreSound;

/* Duration, and time integrals of powers of the frequency-weighted acceleration (ISO 2631-1), SI units.
 * squares, fourths: second and fourth power. above: second power of the part above 80 Hz. */
typedef struct {
    double time_s, squares, fourths, above;
} CoreDose;

/* The part of an actuator's state that a host saves, and that a later process restores. Temperatures: °C. */
typedef struct {
    double coil_c, magnet_c;
    CoreDose dose;
} ActuatorSafety;

/* Settings of one actuator. A change of gain, delay, source or `audible` fades over 40 ms. */
typedef struct {
    double gain;         /* -1 to 1; below 0: inverted polarity */
    double delay_frames; /* 0 or more, added to the delay that all actuators share */
    uint64_t source;     /* index of the vibration channel */
    uint64_t audible;    /* 0: the output fades to silence */
    uint64_t restores;   /* not 0: the first core_process after core_open restores `safety`. F + 1: so does a
                          * core_process after exactly F frames, but only the temperatures */
    ActuatorSafety safety;
} ActuatorControls;

typedef struct {
    double sound_gain; /* factor on the sound, 0 or more; compensates for the listener's volume setting */
    uint64_t day;      /* number of the day; a change resets the doses */
    ActuatorControls actuators[CORE_ACTUATORS];
} CoreControls;

typedef struct {
    double peak, mean_square; /* peak, which falls by 20 dB/s; mean square with a time constant of 0.3 s */
} CoreLevel;

typedef struct {
    CoreLevel level;
    double audible; /* 0: silent; 1: audible; in between: during a fade */
    double gain, least_gain, exposure_gain; /* protection's gain, its minimum so far, its limit from the dose */
    double excursion_m, coil_c, magnet_c;
    CoreDose dose;
    double running_m_s2;     /* frequency-weighted r.m.s. acceleration; time constant: 1 s */
    double undamped_squares; /* dose.squares of the drive before damping; 0 without damping */
    uint64_t blocks, limited_blocks, infeasible_blocks, replaced;
    uint64_t limited_by; /* LimitedBy of drive/protection.h */
} ActuatorReadings;

/* Counts, levels, partials and actuators' readings of a stream. */
typedef struct {
    uint64_t frames, replaced, limited; /* replaced: invalid samples; limited: samples lowered by limiters */
    CoreLevel sound[CORE_CHANNELS], vibration[CORE_CHANNELS];
    uint64_t sequence; /* odd while the partials are written */
    uint64_t partials_count;
    double partials[CORE_PARTIALS][3]; /* Hz of the sound, Hz of the vibration, amplitude */
    ActuatorReadings actuators[CORE_ACTUATORS];
} CoreReadings;

#define CORE_API __attribute__((visibility("default")))

/* Sizes of CoreInfo, CoreSound, CoreControls, ActuatorControls, CoreReadings, ActuatorReadings, in bytes. */
CORE_API extern const uint64_t core_sizes[6];

/* Check a design at an 8-byte aligned address. If it is valid, set info and return NULL; else return an error
 * message. */
CORE_API const char *core_check(const void *design, size_t bytes, CoreInfo *info);

/* Create a core in memory_bytes bytes (see CoreInfo) at a 16-byte aligned address. Return NULL if core_check
 * fails. The design and the memory must stay at their addresses while the core is used. */
CORE_API Core *core_open(const void *design, size_t bytes, void *memory);

/* Reset all signals and motion models. doses_too: also reset temperatures, doses and actuators' counts. */
CORE_API void core_reset(Core *core, int doses_too);

/* Process sound; write the outputs, (frames, actuators), or (frames, vibrations) without actuators.
 * `readings` may be NULL. */
CORE_API void core_process(Core *core, const CoreControls *controls, CoreSound sound, float *out,
                           size_t frames, CoreReadings *readings);

/* Like core_process, but run only the transform: write the vibration, (frames, vibrations), but no levels. */
CORE_API void core_vibrate(Core *core, CoreSound sound, double *vibration, size_t frames,
                           CoreReadings *readings);

/* Copy the stream's state to `state` if `room` bytes suffice. Always return the state's size in bytes. */
CORE_API size_t core_state(Core *core, void *state, size_t room);

/* Restore a saved state and return 1. If the state is damaged or of another design, call core_reset(core, 0)
 * and return 0. */
CORE_API int core_set_state(Core *core, const void *state, size_t bytes);

/* The course of a partial during a hop or tick of the transform. Amplitude 1 is full scale. Phase: cycles. */
typedef struct {
    double frame; /* frames from the recording's start to the first frame */
    double frames, channel, slot;
    double start_hz, end_hz, start_amplitude, end_amplitude, start_phase;
} CoreGlide;

/* Return an upper bound on the number of glides in `frames` frames. */
CORE_API size_t core_glides_max(const Core *core, size_t frames);

/* From now on, record up to `room` glides into `rows`; NULL ends the recording. Return the number of glides
 * that were written to the rows of the previous call. */
CORE_API size_t core_record(Core *core, CoreGlide *rows, size_t room);
