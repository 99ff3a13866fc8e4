/* What the protection of one actuator works by. */

#ifndef CUSHION_PROTECTION_DESIGN_H
#define CUSHION_PROTECTION_DESIGN_H

#include "../../transform/native/arena.h"
#include "lanes.h"

/* What ProtectionDesign says of them is checked against these. */
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

#endif
