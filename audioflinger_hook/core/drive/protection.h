/* Protection of one actuator: predicts excursion, current, level and coil temperature, and lowers the gain
 * before one of them exceeds its limit. The input is the drive: the actuator's signal, 1 at full scale.
 * The output is delayed by two blocks, and its gain changes linearly within a block. */

#pragma once

#include "../core.h"
#include "lanes.h"

enum { MODELS_MAX = 32, STATES_MAX = 12, BLOCK_FRAMES_MAX = 2048, TAIL_POINTS_MAX = 4096 };

/* Length of an impulse response's row: `frames` numbers, then at least LANES zeros. */
#define ROW_FRAMES(frames) WHOLE_LANES((frames) + LANES)

/* The design of an actuator's protection, which device/drive/protection/design.py computes. Impulse responses
 * are time-reversed rows of ROW_FRAMES(frames) numbers. The matrices named _by_state are stored column by
 * column; a column of n numbers takes WHOLE_LANES(n) places. `thermal` is stored row by row without padding.
 * Excursions without a unit are relative to the excursion limit minus a margin. */
typedef struct {
    size_t models, states; /* linear models of the actuator (0: no protection), states per model */
    size_t frames;      /* frames in a block */
    size_t watched;     /* number of frames in a block at which the excursion is computed */
    size_t stride;      /* frames from one watched frame to the next */
    size_t tail_points; /* number of computed points of the free oscillation after a block */
    size_t currents;    /* predicted currents: 1 for the coil's heat, plus 1 per model if current_a > 0 */
    size_t hold_blocks; /* hold time of the demand (see governor.h), blocks */
    const double *excursion_by_drive; /* (models, row) */
    const double *excursion_by_state; /* (models, states, watched) */
    const double *state_by_drive;     /* (models, states, row) */
    const double *state_by_state;     /* (models, states, states) */
    const double *current_by_drive;   /* (currents, row), A */
    const double *current_by_state;   /* (currents, states, frames) */
    const double *tail_by_state;      /* (models, states, tail_points) */
    const double *reach;     /* (models): largest excursion from rest while |drive| <= 1 */
    const double *swing;     /* (models): excursion per sqrt(2 * actuator energy) */
    const double *last_kick; /* (models): sqrt(2 * actuator energy) that an amplifier output of 1 adds */
    const double *ring;      /* (models): largest excursion that amplifier filter states of norm 1 cause */
    double swing_m;          /* excursion in m per sqrt(2 * actuator energy), identified model */
    double level;            /* limit of |drive| */
    double current_a;        /* limit of |current|; 0: no limit */
    /* Changes per block. recovery: largest rise of the gain. release: factor on the demand. notice: weight of
     * the new power in the average power. forget: factor on the wanted power. caution: factor by which a
     * limited block raises the safety factor of the demand. */
    double recovery, release, notice, forget, caution;
    double hottest_k; /* limit of the coil's temperature above ambient; 0: no limit */
    double ambient_c, resistance_ohm, resistance_per_k, coil_k_per_w, coil_j_per_k, approach_s;
    const double *thermal; /* (2, 3) or NULL: from (coil K, magnet K, W) to the next (coil K, magnet K) */
} ProtectionDesign;

typedef enum { NOT_LIMITED, BY_MOTION, BY_TEMPERATURE, BY_EXPOSURE } LimitedBy;

typedef struct Protection Protection;

/* Allocate a protection from the arena. If arena->base is NULL, only count bytes and return NULL. */
Protection *protection_layout(const ProtectionDesign *design, Arena *arena);

/* Reset all signals and models of motion. as_new: reset temperatures, counts and the least gain as well. */
void protection_reset(Protection *protection, int as_new);

/* Process one sample of drive, which must be finite; return the next output sample. gain_ceiling: upper limit
 * of the gain, 0 to 1. */
double protection_step(Protection *protection, double sample, double gain_ceiling);

void protection_report(const Protection *protection, ActuatorReadings *readings);

/* Set the temperatures, K above ambient. A value below 0 becomes 0; a value that is not finite becomes the
 * coil's limit. */
void protection_set_temperatures(Protection *protection, double coil_k, double magnet_k);
