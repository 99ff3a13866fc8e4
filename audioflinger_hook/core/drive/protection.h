/* Protection of one actuator: keeps excursion, current, level and the coil's temperature within limits
 * by gain alone, ahead of time.
 *
 * device/drive/protection/ designs it and says why. A block of drive leaves two blocks later, times a gain
 * that moves in a straight line within the block. */

#pragma once

#include "../core.h"
#include "lanes.h"

/* Largest counts of a design. */
enum { MODELS_MAX = 32, STATES_MAX = 12, BLOCK_FRAMES_MAX = 2048, TAIL_POINTS_MAX = 4096 };

/* Numbers in the row of an impulse response: behind its frames it has LANES zeros and more. */
#define ROW_FRAMES(frames) WHOLE_LANES((frames) + LANES)

/* Made in Python (device/drive/protection/design.py). models 0: no protection. Impulse responses are
 * stored last frame first, in rows of ROW_FRAMES. Matrices are stored by columns of WHOLE_LANES: a state
 * times a matrix is a sum of columns. */
typedef struct {
    size_t models, states;
    size_t frames;      /* of a block */
    size_t watched;     /* frames of a block whose excursion is computed, `stride` apart */
    size_t stride;
    size_t tail_points; /* of the free swing after a block */
    size_t currents;    /* 1: what heats the coil; if the current is limited, that of each model, too */
    size_t hold_blocks; /* for which a demand is held */
    const double *excursion_by_drive; /* (models, row), a share of the limit */
    const double *excursion_by_state; /* (models, states, watched) */
    const double *state_by_drive;     /* (models, states, row) */
    const double *state_by_state;     /* (models, states, states) */
    const double *current_by_drive;   /* (currents, row), A */
    const double *current_by_state;   /* (currents, states, frames) */
    const double *tail_by_state;      /* (models, states, tail_points), a share of the limit */
    const double *reach;     /* (models): largest excursion from rest, for a drive of 1 */
    const double *swing;     /* (models): of the root of twice the actuator's energy */
    const double *last_kick; /* (models): that root after a last output of 1 */
    const double *ring;      /* (models): of an amplifier's state of length 1 */
    double swing_m;          /* metres for that root, of the rig as identified */
    double level;            /* limit of |drive| */
    double current_a;        /* limit; 0 for none */
    double recovery, release, notice, forget, caution; /* of a block */
    double hottest_k; /* limit of the coil above its surroundings; 0 for none */
    double ambient_c, resistance_ohm, resistance_per_k, coil_k_per_w, coil_j_per_k, approach_s;
    const double *thermal; /* coil by coil, magnet and power, then the magnet's; NULL: not described */
} ProtectionDesign;

typedef enum { NOT_LIMITED, BY_MOTION, BY_TEMPERATURE, BY_EXPOSURE } LimitedBy;

typedef struct Protection Protection;

/* Lay out the protection's memory; without memory, only count it. */
Protection *protection_layout(const ProtectionDesign *design, Arena *arena);

/* Come to rest; as new: counts become 0, and the coil is cold. */
void protection_reset(Protection *protection, int as_new);

/* Take one finite sample of drive and return the one that leaves now. gain_ceiling: largest gain, 0 to 1. */
double protection_step(Protection *protection, double sample, double gain_ceiling);

void protection_report(const Protection *protection, ActuatorReadings *readings);

/* Continue with these temperatures, K above the surroundings. */
void protection_set_temperatures(Protection *protection, double coil_k, double magnet_k);
