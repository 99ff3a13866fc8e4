/* The non-linear model of the actuator, and the Born term, which says where the linear one suffices.
 * rig/nonlinear_model.py says the same in NumPy, and what each argument is; rig/equations.py has the
 * equations, rig/step_maps.py the exponentials and tables. */

#include "blocks.h"
#include "nonlinear_path.h"

#define QUIET 1e-3 /* of the least peak */

/* The state of the linear model, and of that with the Born term: the linear answer to the remainder
 * of the linear model. */
typedef struct {
    double linear[STATES], born[STATES];
} Pair;

/* The largest difference between the two in a block, and the peaks of the second. */
typedef struct {
    double peak_y, peak_a, wrong_y, wrong_a;
} Difference;

INLINE void compare(const int n, const Model *m, const double *base, const double *linear,
                    const double *born, double force, Difference *found)
{
    const double y = born[Y] - linear[Y], q = born[Q] - linear[Q];
    double w = born[U] - linear[U], base_w = base[U] + born[U];
    if (n > 3) {
        w -= born[FRAME_SPEED] - linear[FRAME_SPEED];
        base_w -= born[FRAME_SPEED];
    }
    const double a = (force + m->pull * q - m->stiffness * y - m->damping * w) * m->per_mass;
    const double whole_y = base[Y] + born[Y];
    const double whole_a = (force + m->pull * (base[Q] + born[Q]) - m->stiffness * whole_y -
                            m->damping * base_w) * m->per_mass;
    found->wrong_y = larger(found->wrong_y, fabs(y));
    found->wrong_a = larger(found->wrong_a, fabs(a));
    found->peak_y = larger(found->peak_y, fabs(whole_y));
    found->peak_a = larger(found->peak_a, fabs(whole_a));
}

/* Whether the linear solution is so small that what it leaves out, of second order, is nothing. */
INLINE int rests(const Model *m, const double *base)
{
    const double pull = fabs(m->pull * base[Q]) * m->per_mass;
    const double swing = fabs(m->damping * base[U]) * m->per_mass;
    return fabs(base[Y]) <= QUIET * m->least_y && larger(pull, swing) <= QUIET * m->least_a;
}

/* Whether the linear model suffices from start to stop, and where both then are. */
INLINE int suffices(const int n, const Work *work, Path *path, Pair *pair, size_t start, size_t stop,
                    double margin, Difference *found)
{
    const Model *m = work->model;
    const double *map = work->maps, *onward = map + 2, *weights = onward + 2 * n * n;
    const int parts = n > 3 ? PARTS : 2, block = n * parts;
    Difference bound = {m->least_y, m->least_a, 0.0, 0.0};
    for (size_t at = start; at < stop; at += 4 * work->widest) {
        const double base[3] = {work->moved[at], work->moved[work->frames + at],
                                work->moved[2 * work->frames + at] * m->inductance};
        bound.peak_y = larger(bound.peak_y, 2.0 * fabs(base[Y]));
        bound.peak_a = larger(bound.peak_a, 2.0 * fabs(base_acceleration(m, base)));
    }
    int at_rest = n < 4 && rests(m, path->base);
    for (int row = 0; row < n; row++)
        at_rest = at_rest && pair->linear[row] == 0.0 && pair->born[row] == 0.0;
    for (size_t at = start; at < stop; at += work->widest) {
        double bases[2][3], linear[2][STATES] = {{0}}, born[2][STATES] = {{0}};
        double g[3][PARTS];
        End end = {.a = 0.0};
        const double volts =
            find_bases(work, path, map, n, at, work->widest, 0, work->ticks, bases);
        if (at_rest && rests(m, bases[0]) && rests(m, bases[1])) {
            memcpy(path->base, bases[1], sizeof path->base);
            path->volts = volts;
            continue;
        }
        at_rest = 0;
        memcpy(g[0], path->g, sizeof g[0]);
        for (int point = 0; point < 2; point++) {
            const double *p = onward + n * n * point;
            g[point + 1][PUSH] = n > 3 ? m->mass * base_acceleration(m, bases[point]) : 0.0;
            for (int row = 0; row < n; row++)
                for (int column = 0; column < n; column++) {
                    linear[point][row] += p[row * n + column] * pair->linear[column];
                    born[point][row] += p[row * n + column] * pair->born[column];
                }
        }
        for (int point = 0; n > 3 && point < 2; point++)
            for (int row = 0; row < n; row++)
                for (int from = 0; from < 3; from++)
                    linear[point][row] +=
                        weights[(3 * point + from) * block + row * parts + PUSH] * g[from][PUSH];
        for (int point = 0; point < 2; point++) {
            memcpy(end.d, linear[point], sizeof end.d);
            if (!settle(n, work, bases[point], 0.0, &end))
                return 0;
            g[point + 1][FORCE] = end.g[FORCE];
            g[point + 1][VOLTS] = end.g[VOLTS];
        }
        for (int point = 0; point < 2; point++) {
            for (int row = 0; row < n; row++)
                for (int from = 0; from < 3; from++)
                    for (int part = 0; part < parts; part++)
                        born[point][row] += weights[(3 * point + from) * block + row * parts + part] *
                                            g[from][part];
            compare(n, m, bases[point], linear[point], born[point], g[point + 1][FORCE], found);
        }
        const double wrong = larger(found->wrong_y / bound.peak_y, found->wrong_a / bound.peak_a);
        if (!(margin * wrong <= m->tolerance))
            return 0;
        memcpy(path->g, g[2], sizeof g[2]);
        memcpy(path->base, bases[1], sizeof path->base);
        path->volts = volts;
        memcpy(pair->linear, linear[1], sizeof pair->linear);
        memcpy(pair->born, born[1], sizeof pair->born);
    }
    return margin * found->wrong_y <= m->tolerance * larger(found->peak_y, m->least_y) &&
           margin * found->wrong_a <= m->tolerance * larger(found->peak_a, m->least_a);
}

/* How many of the first blocks the linear model suffices for. */
INLINE size_t count(const int n, const Work *work, Path *path, Pair *pair, size_t start, size_t stop,
                    size_t first, size_t each, double margin)
{
    size_t blocks = 0, until = start + first;
    double d[STATES];
    memcpy(d, path->d, sizeof d);
    memcpy(path->d, pair->linear, sizeof path->d);
    const int begun = begin(n, work, path);
    while (begun && start < stop) {
        const Path before = *path;
        const Pair pair_before = *pair;
        Difference found = {0};
        if (!suffices(n, work, path, pair, start, until, margin, &found)) {
            *path = before;
            *pair = pair_before;
            break;
        }
        double *row = work->report + 4 * blocks++;
        row[0] = found.peak_y;
        row[1] = found.peak_a;
        row[2] = margin * found.wrong_y;
        row[3] = margin * found.wrong_a;
        start = until;
        until += each;
    }
    memcpy(path->d, d, sizeof d);
    path->fresh = 1.0;
    return blocks;
}

/* at: the first sample and that after the last, the length of the first block and of the others. */
SIMD_CLONES static size_t run_on_ground(const Work *work, Path *path, const size_t at[4])
{
    return run(3, work, path, at[0], at[1], at[2], at[3]);
}

SIMD_CLONES static size_t run_on_seat(const Work *work, Path *path, const size_t at[4])
{
    return run(5, work, path, at[0], at[1], at[2], at[3]);
}

SIMD_CLONES static size_t count_on_ground(const Work *work, Path *path, Pair *pair, const size_t at[4],
                                   double margin)
{
    return count(3, work, path, pair, at[0], at[1], at[2], at[3], margin);
}

SIMD_CLONES static size_t count_on_seat(const Work *work, Path *path, Pair *pair, const size_t at[4],
                                 double margin)
{
    return count(5, work, path, pair, at[0], at[1], at[2], at[3], margin);
}

enum { VOLTAGE, MOVED, MODEL, TABLE, MAPS, BASES, STATE, REPORT, TWO, ARRAYS };

static const char *misfit_of(const View *v, const size_t *n, int arrays)
{
    const size_t states = v[MODEL].ndim == 1 && v[MOVED].ndim == 2 ? v[MOVED].shape[0] : 0;
    const size_t frames = states ? v[MOVED].shape[1] : 0;
    const size_t each = n[3], start = n[0], stop = n[1], first = n[2];
    const size_t reports = each && stop > start + first ? 1 + (stop - start - first) / each : 1;
    if (v[VOLTAGE].ndim != 1 || states != 5 || v[VOLTAGE].shape[0] != frames)
        return "volts and moved: not (frames,) and (5, frames)";
    if (start > stop || stop > frames || !first || !each || (arrays == ARRAYS && first > stop - start))
        return "start, stop: no part of the volts, or blocks without frames";
    if (v[MODEL].len != sizeof(Model) || v[STATE].len != sizeof(Path))
        return "model or path: of another length";
    if (v[TABLE].ndim != 2 || v[TABLE].shape[1] != 16)
        return "table: not (intervals, 16)";
    if ((double)v[TABLE].shape[0] < ((const Model *)v[MODEL].buf)->intervals)
        return "table: fewer intervals than the model says";
    if (v[MAPS].ndim != 2 || v[BASES].ndim != 3 || v[BASES].shape[1] != COLUMNS)
        return "maps and bases: not (levels, numbers) and (levels, 8, samples)";
    const size_t widest = v[BASES].shape[2], whole = v[BASES].shape[0];
    if (!whole || whole > 24 || widest > MOST_SAMPLES || widest != (size_t)1 << (whole - 1) ||
        v[MAPS].shape[0] < whole || v[MAPS].shape[0] > whole + 24)
        return "bases: not one level for each halving to a sample";
    if (v[MAPS].shape[1] != 2 + 18 + 48 + 30 && v[MAPS].shape[1] != 2 + 50 + 120 + 30)
        return "maps: for neither 3 nor 5 states";
    if (((const Path *)v[STATE].buf)->level < 0.0 ||
        !(((const Path *)v[STATE].buf)->level < (double)v[MAPS].shape[0]))
        return "path: at no level";
    if (v[REPORT].ndim != 2 || v[REPORT].shape[1] != 4 || v[REPORT].shape[0] < reports)
        return "report: not (blocks, 4) for all blocks";
    if (arrays == ARRAYS && (v[TWO].len != sizeof(Pair) || widest < 2 || first % widest ||
                             each % widest || (stop - start - first) % each))
        return "pair: not (2, 5), or blocks of a part of a step";
    return NULL;
}

static Work work_of(const View *views)
{
    Work work = {.model = views[MODEL].buf, .table = views[TABLE].buf, .maps = views[MAPS].buf,
                 .bases = views[BASES].buf, .volts = views[VOLTAGE].buf, .moved = views[MOVED].buf,
                 .report = views[REPORT].buf, .frames = views[VOLTAGE].shape[0],
                 .levels = views[MAPS].shape[0], .map_size = views[MAPS].shape[1],
                 .widest = views[BASES].shape[2]};
    work.sample_s = *(const double *)work.maps / (double)work.widest;
    work.ticks = (size_t)1 << (work.levels - views[BASES].shape[0]);
    return work;
}

static int is_on_seat(const Work *work) { return work->map_size > 100; }

const char *blocks_nonlinear_motion(const View views[8], const size_t numbers[4], size_t mask,
                                    size_t *done)
{
    const char *misfit = misfit_of(views, numbers, TWO);
    if (misfit)
        return misfit;
    Work work = work_of(views);
    work.mask = mask;
    const unsigned long long tiny = flush_tiny_numbers();
    *done = is_on_seat(&work) ? run_on_seat(&work, views[STATE].buf, numbers)
                              : run_on_ground(&work, views[STATE].buf, numbers);
    usual_numbers(tiny);
    return NULL;
}

const char *blocks_linear_suffices(const View views[9], const size_t numbers[4], double margin,
                                   size_t *found)
{
    const char *misfit = misfit_of(views, numbers, ARRAYS);
    if (misfit)
        return misfit;
    const Work work = work_of(views);
    Path *path = views[STATE].buf;
    Pair *pair = views[TWO].buf;
    const unsigned long long tiny = flush_tiny_numbers();
    *found = is_on_seat(&work) ? count_on_seat(&work, path, pair, numbers, margin)
                               : count_on_ground(&work, path, pair, numbers, margin);
    usual_numbers(tiny);
    return NULL;
}
