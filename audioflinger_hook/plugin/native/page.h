/* The page of memory that the daemon and the plugin share; plugin/page.py reads the same layout.
 *
 * The daemon names the file in HAPTIC_CUSHION_PAGE. Each value has one writer and is written at
 * once, so neither side waits for the other. Readings are the plugin's, wishes the daemon's. */

#ifndef CUSHION_PAGE_H
#define CUSHION_PAGE_H

#include <stdint.h>

#define PAGE_MAGIC UINT64_C(0x3445474150485543) /* "CUHPAGE4" */
#define PAGE_CHANNELS 8
#define PAGE_ACTUATORS 32
#define PAGE_PARTIALS 16
#define SECTION_NUMBERS 6

/* What the transform is to do; read once, when it is made. */
typedef struct {
    uint64_t channels; /* of the tap */
    uint64_t outputs;  /* vibrations */
    uint64_t mixed; /* 1: each output is a mix by the weights; 0: the mono mix, or each channel */
    /* Of an output's channels: in the mean of its halves, then in half their difference. */
    double weights[PAGE_CHANNELS][2][PAGE_CHANNELS];
} TransformWishes;

typedef struct {
    uint64_t frames, replaced, limited;
    uint64_t samplerate;   /* Hz; of the host: all is silent where the design is for another one */
    uint64_t cycle_frames; /* of the latest call */
    double sound_peak, sound_square;         /* of the tap */
    double vibration_peak, vibration_square; /* of the transform */
    double channels[PAGE_CHANNELS][2];       /* peak and square of each of the tap's */
} TransformReadings;

/* What the latest hop vibrates. The sequence is odd while the plugin writes; who reads it changed or
 * odd reads again. */
typedef struct {
    uint64_t sequence;
    uint64_t count;
    double partials[PAGE_PARTIALS][3]; /* Hz of the sound, Hz of vibration, amplitude */
} PartialReadings;

typedef struct {
    double gain;      /* -1 to 1 */
    double delay_s;   /* 0 to 2 */
    uint64_t audible; /* 0 or 1 */
    uint64_t damped;  /* whether the section below is in use */
    double damping_gain;
    double section[SECTION_NUMBERS]; /* b0 b1 b2 1 a1 a2 */
} ActuatorWishes;

typedef struct {
    uint64_t frames;
    double peak, square;
    double audible; /* the fade's factor, 0 to 1 */
} ActuatorReadings;

typedef struct {
    uint64_t magic;
    uint64_t size;     /* of all of it */
    double sound_gain; /* factor on the tap's samples; changes over one buffer */
    TransformWishes transform;
    TransformReadings readings;
    PartialReadings partials;
    ActuatorWishes wishes[PAGE_ACTUATORS];
    ActuatorReadings actuators[PAGE_ACTUATORS];
} Page;

/* Aligned words are read and written whole; the compiler must neither leave out nor repeat it. */
#define PAGE_LOAD(place, into) __atomic_load(&(place), &(into), __ATOMIC_RELAXED)
#define PAGE_STORE(place, value)                                                                   \
    do {                                                                                           \
        __typeof__(place) word_ = (value);                                                         \
        __atomic_store(&(place), &word_, __ATOMIC_RELAXED);                                        \
    } while (0)

/* The page that the environment names, NULL where it names none or nothing that fits. Each call
 * maps it anew. */
Page *page_open(void);

void page_close(Page *page);

#endif
