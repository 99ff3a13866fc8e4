/* Simulates each block with the linear model or, if its error exceeds the tolerance, the non-linear model. */

#include "blocks.h"
#include "rig_steps.h"

/* Compute the residual: the force (N) and the voltage (V) that the linear model neglects at a frame. */
INLINE void find_residual(const Work *w, size_t frame, double g[2])
{
    const Model *m = w->model;
    const double y = w->moved[frame], speed = w->moved[w->frames + frame];
    const double linear_a = w->moved[2 * w->frames + frame], q = m->inductance * linear_a;
    double at[6];
    look_up(m, w->table, y, at);
    const double current = q * at[1], depth = fabs(y) - m->stop_m;
    g[FORCE] = (at[0] + at[2] * current) * current - m->force_factor * linear_a - at[3] + m->stiffness * y;
    if (depth > 0.0) {
        const double pressed = m->stop_n_per_m2 * depth * depth;
        g[FORCE] -= copysign(pressed, y) + m->stop_loss_s_per_m * pressed * speed;
    }
    g[VOLTS] = m->ohm_at_rest * linear_a - m->ohm * current - (at[0] - m->force_factor) * speed;
}

/* Advance the correction by `coarse` samples, in which the residual changes linearly from `last` to `new`. */
INLINE void advance_correction(const int n, const double *map, const double last[2], const double new[2],
                               double *d)
{
    const double *by_last = map + n * n, *by_new = by_last + 2 * n;
    double next[MOST_STATES];
    for (int row = 0; row < n; row++) {
        double sum = by_last[2 * row] * last[0] + by_last[2 * row + 1] * last[1] +
                     by_new[2 * row] * new[0] + by_new[2 * row + 1] * new[1];
        for (int k = 0; k < n; k++)
            sum += map[row * n + k] * d[k];
        next[row] = sum;
    }
    memcpy(d, next, (size_t)n * sizeof *d);
}

/* Return the linear model's error: the larger of |correction of the excursion| / peaks[0] and |correction of
 * the acceleration| / peaks[1]. */
INLINE double error_of(const int n, const Model *m, const double *d, const double g[2], const double peaks[2])
{
    const double speed = n > 3 ? d[U] - d[FRAME_SPEED] : d[U];
    const double force = g[FORCE] + m->force_factor / m->inductance * d[Q] -
                         m->stiffness * d[Y] - m->damping * speed;
    const double of_y = fabs(d[Y]) / peaks[0], of_a = fabs(force) / m->mass / peaks[1];
    return of_y > of_a ? of_y : of_a;
}

/* Return `margin` times the linear model's largest error in a block; stop as soon as this exceeds the
 * tolerance. */
INLINE double estimate_error(const int n, const Work *w, State *at, size_t start, size_t stop,
                         const double peaks[2])
{
    const Model *m = w->model;
    const size_t coarse = (size_t)m->coarse;
    double g[2];
    find_residual(w, stop - 1, g);
    double worst = error_of(n, m, at->correction, g, peaks);
    for (size_t frame = start + coarse - 1 - (size_t)at->since; frame < stop; frame += coarse) {
        if (m->margin * worst > m->tolerance)
            break;
        find_residual(w, frame, g);
        advance_correction(n, w->by_coarse, at->residual, g, at->correction);
        memcpy(at->residual, g, sizeof g);
        const double error = error_of(n, m, at->correction, g, peaks);
        worst = error > worst ? error : worst;
    }
    return m->margin * worst;
}

enum { AUTO, LINEAR, NONLINEAR };

#define ALIKE 0.7          /* a peak excursion below ALIKE * failed_peak_y sets blocks_to_skip to 0 */
#define SKIPPED_BLOCKS 7.0 /* blocks_to_skip after a block in which the linear model's error is too large */

/* Convert the state to the linear or the non-linear model, unless it already belongs to that model. Excursion,
 * speed and current do not change. The flux changes, because the inductances of the models differ. */
INLINE void hand_over(const Work *w, State *at, int to_linear)
{
    if ((at->is_linear != 0.0) == to_linear)
        return;
    double found[6];
    look_up(w->model, w->table, at->s[Y], found);
    const double flux = at->s[Q], ratio = found[1] * w->model->inductance;
    at->s[Q] = to_linear ? flux * ratio : flux / ratio;
    at->correction[Q] += flux - at->s[Q];
    at->is_linear = to_linear;
}

/* Simulate a block with the linear model; return 1 if the error is within the tolerance. Otherwise restore
 * the state and return 0. While blocks_to_skip is above 0, decrease it and return 0 without a simulation. */
INLINE int is_linear_enough(const int n, const Work *w, State *at, size_t start, size_t stop, double *error)
{
    const Model *m = w->model;
    const State before = *at;
    double peaks[2] = {m->least_y, m->least_a};
    if (at->blocks_to_skip > 0.0) {
        at->blocks_to_skip -= 1.0;
        return 0;
    }
    hand_over(w, at, 1);
    run_linear(n, w, at, start, stop, peaks);
    *error = estimate_error(n, w, at, start, stop, peaks);
    if (*error <= m->tolerance)
        return 1;
    *at = before;
    at->failed_peak_y = 0.0;
    at->blocks_to_skip = SKIPPED_BLOCKS;
    return 0;
}

/* Let the correction decay during a block of the non-linear model. */
INLINE void decay_correction(const int n, const Work *w, State *at, size_t start, size_t stop)
{
    const size_t coarse = (size_t)w->model->coarse;
    const double nothing[2] = {0};
    for (size_t frame = start + coarse - 1 - (size_t)at->since; frame < stop; frame += coarse) {
        advance_correction(n, w->by_coarse, at->residual, nothing, at->correction);
        memset(at->residual, 0, sizeof at->residual);
    }
}

/* Simulate a block. report[0]: 1 if the block used the non-linear model, else 0. report[1]: estimated error
 * of the linear model; 0 if the block used the non-linear model or `model` is LINEAR. */
INLINE void run_block(const int n, const Work *w, State *at, size_t model, size_t start, size_t stop,
                      double report[2])
{
    double unused[2] = {0}, error = 0.0;
    int is_linear = model == LINEAR;
    if (is_linear) {
        hand_over(w, at, 1);
        run_linear(n, w, at, start, stop, unused);
    } else if (model == AUTO)
        is_linear = is_linear_enough(n, w, at, start, stop, &error);
    if (!is_linear) {
        hand_over(w, at, 0);
        const double peak_y = run_runge_kutta(n, w, at, start, stop);
        if (at->failed_peak_y == 0.0)
            at->failed_peak_y = peak_y;
        if (peak_y < ALIKE * at->failed_peak_y)
            at->blocks_to_skip = 0.0;
        if (model == AUTO)
            decay_correction(n, w, at, start, stop);
    }
    report[0] = !is_linear;
    report[1] = is_linear ? error : 0.0;
    at->since = (double)(((size_t)at->since + stop - start) % (size_t)w->model->coarse);
}

INLINE void run(const int n, const Work *w, State *at, const size_t numbers[5], double *report)
{
    const size_t stop = numbers[1], each = numbers[3];
    size_t start = numbers[0], until = start + numbers[2];
    for (; start < stop; until += each, report += 2) {
        until = until < stop ? until : stop;
        run_block(n, w, at, numbers[4], start, until, report);
        start = until;
    }
}

SIMD_CLONES static void run_on_ground(const Work *w, State *at, const size_t numbers[5], double *report)
{
    run(3, w, at, numbers, report);
}

SIMD_CLONES static void run_on_seat(const Work *w, State *at, const size_t numbers[5], double *report)
{
    run(5, w, at, numbers, report);
}

enum { DRIVE, MOVED, MODEL, TABLE, STEPS, BY_SAMPLE, BY_COARSE, STATE, REPORT };

static const char *misfit_of(const View *v, const size_t numbers[5])
{
    const size_t start = numbers[0], stop = numbers[1], first = numbers[2], each = numbers[3];
    if (v[DRIVE].ndim != 1 || v[MOVED].ndim != 2 || v[MOVED].shape[1] != v[DRIVE].shape[0] ||
        (v[MOVED].shape[0] != 4 && v[MOVED].shape[0] != 5))
        return "volts and moved: not (frames,) and (4 or 5, frames)";
    if (start > stop || stop > v[DRIVE].shape[0] || !first || !each || numbers[4] > NONLINEAR)
        return "start, stop: no part of the volts, or blocks without frames";
    if (v[MODEL].len != sizeof(Model) || v[STATE].len != sizeof(State))
        return "model or state: of another length";
    const Model *m = v[MODEL].buf;
    const State *at = v[STATE].buf;
    if (v[TABLE].ndim != 2 || v[TABLE].shape[1] != 16 || !(m->intervals >= 1.0) ||
        (double)v[TABLE].shape[0] != m->intervals)
        return "table: not (intervals, 16)";
    if (v[STEPS].ndim != 2 || v[STEPS].shape[1] != 12 || !(m->levels >= 1.0 && m->levels < 32.0) ||
        (double)v[STEPS].shape[0] != m->levels || !(m->first_level >= 0.0 && m->first_level < m->levels))
        return "steps: not (levels, 12)";
    const size_t n = v[MOVED].shape[0] == 5 ? 5 : 3;
    if (v[BY_SAMPLE].len != n * (n + 2) * sizeof(double) ||
        v[BY_COARSE].len != n * (n + 4) * sizeof(double) ||
        !(m->coarse >= 1.0 && m->coarse < 1e6 && at->since >= 0.0 && at->since < m->coarse))
        return "maps: for another number of states, or of no grid";
    const size_t reports = stop > start + first ? 2 + (stop - start - first - 1) / each : 1;
    if (v[REPORT].ndim != 2 || v[REPORT].shape[1] != 2 || v[REPORT].shape[0] < reports)
        return "report: not (blocks, 2) for all blocks";
    return NULL;
}

const char *blocks_move_rig(const View views[9], const size_t numbers[5])
{
    const char *misfit = misfit_of(views, numbers);
    if (misfit)
        return misfit;
    const Work work = {.model = views[MODEL].buf, .table = views[TABLE].buf, .steps = views[STEPS].buf,
                       .volts = views[DRIVE].buf, .moved = views[MOVED].buf, .frames = views[DRIVE].shape[0],
                       .by_sample = views[BY_SAMPLE].buf, .by_coarse = views[BY_COARSE].buf};
    const unsigned long long tiny = flush_tiny_numbers();
    (views[MOVED].shape[0] == 5 ? run_on_seat : run_on_ground)(&work, views[STATE].buf, numbers,
                                                               views[REPORT].buf);
    usual_numbers(tiny);
    return NULL;
}
