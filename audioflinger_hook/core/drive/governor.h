/* The models of one actuator, block by block: with the gains that leave, and ungoverned, without any.
 *
 * A scalar reference governor (Gilbert, Kolmanovsky and Tan 1995) on several linear models. The drive of
 * block k is u (g' (1 - r) + g r): r rises from 0 to 1, g' is the last gain, g the new one. Every model must
 * stay within the limits during block k, during block k + 1 while the gain falls to 0, and in the free swing
 * after that. All of this is a + g b, so every frame bounds g. What the ungoverned models exceed the limits
 * by is the demand. */

#pragma once

#include "protection.h"

/* A state of every model, or what lies at some frames of all of them. */
typedef double *Column;

/* A block of drive, and what it does to the models while its gain falls to 0, and while it rises. */
typedef struct {
    double *drive, loudest;
    int has_responses;
    Column excursion[2], state[2], current[2];
} Block;

typedef struct {
    const ProtectionDesign *design;
    double gain;                    /* of the last frame that left */
    Column state, ungoverned;       /* (models, states) */
    int is_ungoverned_equal;        /* both are the same: the second is not in use */
    Column end[PARTS], ends[PARTS]; /* states after the known block, and after the next one's fall */
    Column column, spare;           /* scratch: of one model's frames */
    double *fixed, *per_gain;       /* scratch: of all limited quantities, a and b */
    size_t quantities;
    double *scaled[2];              /* scratch: a row each */
    Block blocks[2];
    int known; /* index of the known block; the other one is coming */
} Governor;

INLINED Block *known_block(const Governor *g) { return (Block *)&g->blocks[g->known]; }

INLINED Block *coming_block(const Governor *g) { return (Block *)&g->blocks[!g->known]; }

typedef struct {
    double gain, demand; /* demand: the largest share of a limit, ungoverned */
    double power[4];     /* mean square of the current in A²: of 1, g and g², and ungoverned */
    int infeasible;      /* no gain keeps all limits */
} GainDecision;

/* Lay out the governor's memory; without memory, only count it. */
void governor_layout(Governor *governor, const ProtectionDesign *design, Arena *arena);

/* Come to rest, with a gain of 1. */
void governor_reset(Governor *governor);

/* Take the coming block as complete. */
void governor_take(Governor *governor);

/* Whether nothing moves and nothing comes, and the exact rest. */
int governor_is_at_rest(const Governor *governor);
void governor_rest(Governor *governor);

/* Advance all models by the known block, unchanged, if no limit is in reach; write its current's mean
 * square. Return whether it did. */
int governor_advance_unlimited(Governor *governor, double *mean_a2);

/* Return the largest gain of the known block up to the requested one with which everything can still be
 * stopped. */
GainDecision governor_decide(Governor *governor, double requested_gain);

/* Advance by the known block with a gain, at most the decided one. */
void governor_advance(Governor *governor, double gain);

/* Let the coming block become the known one. */
INLINED void governor_next(Governor *g) { g->known = !g->known; }

/* The amplitude in metres for which the energy of the rig as identified is enough. */
double governor_excursion_m(const Governor *governor);
