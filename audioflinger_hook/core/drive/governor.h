/* Computes the gain of each block of one actuator with a scalar reference governor (Gilbert, Kolmanovsky and
 * Tan 1995). The output of block k is u (g' (1 - r) + g r): u is the drive, g' the previous gain, g the gain
 * of block k. The ramp r rises from 0 to 1. In every linear model of the actuator, the limits must hold
 * during block k. They must also hold if the gain falls to 0 during block k + 1, and in the free oscillation
 * afterwards. At each frame, each limited quantity, such as the excursion, is a + g b; its limit bounds g.
 * The ungoverned models run with a constant gain of 1. The demand is the largest limited quantity of the
 * ungoverned models, as a fraction of the quantity's limit. */

#pragma once

#include "protection.h"

/* A block of drive, and the models' responses to the drive times a gain. [0]: the gain falls from 1 to 0.
 * [1]: the gain rises from 0 to 1. */
typedef struct {
    double *drive, loudest; /* loudest: largest |drive| */
    int has_responses;
    double *excursion[2], *state[2], *current[2]; /* of all models; currents in A */
} Block;

typedef struct {
    const ProtectionDesign *design;
    double gain;                    /* at the end of the previous block */
    double *state, *ungoverned;     /* states: (models, states) */
    int is_ungoverned_equal;        /* 1: `ungoverned` is equal to `state`, and only `state` is updated */
    double *end[PARTS], *ends[PARTS]; /* end: after the known block; ends: after the coming block, one model */
    double *column, *spare;         /* work space for the frames of one model */
    double *fixed, *per_gain;       /* work space: a and b of all limited quantities */
    size_t quantities;              /* number of pairs a, b */
    double *scaled[2];              /* work space: drive with a falling gain, drive with a rising gain */
    Block blocks[2];
    int known; /* index of the known block, k; the other block, k + 1, is the coming block */
} Governor;

INLINED Block *known_block(const Governor *g) { return (Block *)&g->blocks[g->known]; }

INLINED Block *coming_block(const Governor *g) { return (Block *)&g->blocks[!g->known]; }

typedef struct {
    double gain, demand; /* demand: see the start of this file */
    double power[4];     /* mean square current, A²: coefficients of 1, g, g²; then the ungoverned value */
    int infeasible;      /* no gain keeps all limits */
} GainDecision;

void governor_layout(Governor *governor, const ProtectionDesign *design, Arena *arena);

/* Reset models and blocks; set the gain to 1. */
void governor_reset(Governor *governor);

/* Set `loudest` of the coming block, whose drive is complete. */
void governor_take(Governor *governor);

/* Return whether the known and the coming block are silent, and the remaining motion is negligible. */
int governor_is_at_rest(const Governor *governor);
/* Set all states to 0 and the gain to 1. */
void governor_rest(Governor *governor);

/* If a quick bound shows that no limit can be reached, advance all models by the known block with a gain of
 * 1, write the mean square of the coil's current, A², and return 1. Otherwise return 0. */
int governor_advance_unlimited(Governor *governor, double *mean_a2);

/* Find the largest gain of the known block, up to requested_gain, for which all limits hold. They must also hold
 * if the gain falls to 0 in the coming block. If no gain is allowed, set gain to 0 and `infeasible` to 1. */
GainDecision governor_decide(Governor *governor, double requested_gain);

/* After governor_decide, advance all models by the known block, in which the gain moves to `gain`. `gain`
 * must not exceed the decided gain. */
void governor_advance(Governor *governor, double gain);

INLINED void governor_next(Governor *g) { g->known = !g->known; }

/* Return the excursion amplitude, m, of a free oscillation with the identified model's present mechanical
 * energy. */
double governor_excursion_m(const Governor *governor);
