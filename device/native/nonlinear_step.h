/* One step of the actuator's models: what it knows, g at a point, and the sweeps that solve it. */

#ifndef DEVICE_NONLINEAR_STEP_H
#define DEVICE_NONLINEAR_STEP_H

#include <math.h>
#include <stddef.h>
#include <string.h>

#define STATES 5
#define PARTS 3
#define COLUMNS 8 /* of the basis: four of a cubic, four of one through other points */
#define MOST_SWEEPS 12
#define GROW 0.05 /* of the tolerance: twice the width then has less than half of it */
#define ENOUGH 0.1
#define SMOOTH 0.2
#define CONTACT 10.0
#define ROUGH 4.0
#define INLINE static inline __attribute__((always_inline))

enum { Y, U, Q, FRAME, FRAME_SPEED };
enum { FORCE, VOLTS, PUSH };

typedef struct {
    double mass, damping, stiffness, force_factor, inductance, linear_ohm, ohm;
    double stop, hardness, stop_loss, lowest, per_m, intervals;
    double frame_mass, frame_stiffness, frame_damping;
    double least_y, least_a, least_i, tolerance, fine_s, safety, linear;
    double pull, per_mass; /* N/Wb at rest and 1/kg */
    double kept, from_last, from_new; /* of a flux from sample to sample, and of a voltage */
} Model;

/* What a path keeps between its steps. */
typedef struct {
    double d[STATES], g[PARTS], base[3], volts;
    double a, i, resisting, frame;                          /* of d at the node */
    double before[PARTS], middle[PARTS];                    /* g of the step before */
    double middle_a, middle_i, middle_resisting, width;     /* and its middle */
    double middle_q, force_q, volts_q, current_q, at_force_q, at_volts_q, at_current_q;
    double flux, middle_flux, force_qq;
    double error[STATES], level, largest_a, largest_i, fresh;
    double peak_y, peak_a, worst_y, worst_a, sweeps, steps; /* since the last report */
} Path;

typedef struct {
    double force, volts, current, resisting, acceleration;
    /* Change of g, and of the current of d, with the flux; of the force with its square. */
    double flux, force_q, volts_q, current_q, force_qq;
} Point;

typedef struct {
    double d[STATES], g[PARTS], a, i, frame;
    Point at;
} End;

typedef struct {
    const Model *model;
    const double *table, *maps, *bases, *volts;
    double *moved, *report;
    size_t frames, levels, map_size, widest, mask;
    double sample_s;
    size_t ticks; /* of the shortest step to a sample */
} Work;

INLINE double larger(double a, double b) { return a > b ? a : b; }

INLINE double cubic(const double *c, double t) { return c[0] + t * (c[1] + t * (c[2] + t * c[3])); }

/* g at one point. `own` is the weight of its voltage in its own flux, which is solved for: a small
 * inductance is then no harder than a large one. 0 where the tables end. */
INLINE int evaluate(const Model *m, const double *table, double y, double w, double q, double own,
                    Point *at)
{
    if (m->linear != 0.0) {
        at->force = at->volts = at->resisting = at->force_q = at->volts_q = at->current_q = at->force_qq = 0.0;
        at->flux = q;
        at->current = q / m->inductance;
        at->acceleration = (m->pull * q - m->stiffness * y - m->damping * w) * m->per_mass;
        return 1;
    }
    const double place = (y - m->lowest) * m->per_m;
    if (!(place >= 0.0 && place < m->intervals))
        return 0;
    const size_t interval = (size_t)place;
    const double t = place - (double)interval, *row = table + 16 * interval;
    const double factor = cubic(row, t), per_h = cubic(row + 4, t);
    const double bend = cubic(row + 8, t), spring = cubic(row + 12, t);
    const double rest = m->ohm * per_h - m->linear_ohm / m->inductance;
    const double back = (factor - m->force_factor) * w;
    q = (q - own * back) / (1.0 + own * rest);
    const double i = q * per_h, depth = fabs(y) - m->stop;
    double resisting = spring - m->stiffness * y;
    if (depth > 0.0) {
        const double pressed = m->hardness * depth * depth;
        resisting += copysign(pressed, y) + m->stop_loss * pressed * w;
    }
    at->force = (factor + bend * i) * i - m->pull * q - resisting;
    at->volts = -rest * q - back;
    at->current = i;
    at->resisting = resisting;
    at->flux = q;
    at->force_q = factor * per_h - m->pull;
    at->force_qq = bend * per_h * per_h;
    at->volts_q = -rest;
    at->current_q = per_h - 1.0 / m->inductance;
    at->acceleration = (at->force + m->pull * q - m->stiffness * y - m->damping * w) * m->per_mass;
    return 1;
}

INLINE double base_acceleration(const Model *m, const double *base)
{
    return (m->pull * base[Q] - m->stiffness * base[Y] - m->damping * base[U]) * m->per_mass;
}

/* From the state at one point, g there. 0 where it has none. */
INLINE int settle(const int n, const Work *work, const double *base, double own, End *end)
{
    const Model *m = work->model;
    const double w = base[U] + end->d[U] - (n > 3 ? end->d[FRAME_SPEED] : 0.0);
    const double q = base[Q] + end->d[Q] - own * end->g[VOLTS];
    if (!evaluate(m, work->table, base[Y] + end->d[Y], w, q, own, &end->at))
        return 0;
    end->g[FORCE] = end->at.force;
    end->g[VOLTS] = end->at.volts;
    return 1;
}

/* What the samples show of d at a point whose g is known. */
INLINE void show(const int n, const Model *m, const double *base, End *end)
{
    const double *d = end->d;
    const double w = d[U] - (n > 3 ? d[FRAME_SPEED] : 0.0);
    end->a = (end->g[FORCE] + m->pull * d[Q] - m->stiffness * d[Y] - m->damping * w) * m->per_mass;
    end->i = end->at.current - base[Q] / m->inductance;
    end->frame = 0.0;
    if (n > 3)
        end->frame = -(m->mass * end->a + end->g[PUSH] + m->frame_stiffness * d[FRAME] +
                       m->frame_damping * d[FRAME_SPEED]) / m->frame_mass;
}

/* The third divided difference over a step and the middle before it, times the width cubed. */
typedef struct {
    double end, middle, node, before;
} Third;

INLINE Third third_of(double width, double before)
{
    if (before == width)
        return (Third){4.0 / 3.0, -4.0, 4.0, -4.0 / 3.0};
    const double ratio = before / width, share = 2.0 / (1.0 + ratio), all = 1.0 / (1.0 + 0.5 * ratio);
    return (Third){2.0 * all, -(4.0 + 2.0 * share) * all,
                   (2.0 + share * (2.0 + 2.0 / ratio)) * all, -2.0 * share / ratio * all};
}

INLINE double third(const Third *t, double end, double middle, double node, double before)
{
    return t->end * end + t->middle * middle + t->node * node + t->before * before;
}

INLINE double squares_of(const Third *t, const Path *path, const End ends[2])
{
    const double end = ends[1].at.flux, middle = ends[0].at.flux;
    return third(t, end * end, middle * middle, path->flux * path->flux,
                 path->middle_flux * path->middle_flux);
}

/* What the linear solution's flux adds to that of g: it is as rough as the voltage. */
INLINE void of_base(const int n, const Model *m, const Path *path, const Third *t,
                    const double bases[2][3], const End ends[2], double parts[PARTS])
{
    const double flux = third(t, bases[1][Q], bases[0][Q], path->base[Q], path->middle_q);
    parts[FORCE] = path->force_q * flux + path->force_qq * squares_of(t, path, ends);
    parts[VOLTS] = path->volts_q * flux;
    if (n > 3)
        parts[PUSH] = m->pull * flux;
}

#define MOST_SAMPLES 256

/* What samples of a step have beyond the parabola through its points: the linear solution's flux is
 * as rough as the voltage, but changes g in proportion. */
typedef struct {
    double a[MOST_SAMPLES], i[MOST_SAMPLES];
    int any;
} Rough;

/* Finds it, and adds its effect to the state at the middle and the end. */
INLINE void find_rough(const int n, const int parts, const double *weights, const Work *work,
                       const Path *path, size_t level, size_t at, size_t width,
                       const double bases[2][3], const End ends[2], double known[2][STATES],
                       Rough *rough)
{
    const Model *m = work->model;
    const double *b = work->bases + level * COLUMNS * work->widest + 4 * work->widest;
    const double *current = work->moved + 2 * work->frames + at;
    const size_t stride = work->widest;
    double *restrict left = rough->i, largest = 0.0;
    for (size_t k = 0; k < width; k++) {
        left[k] = m->inductance * current[k] - b[k] * path->base[Q] -
                  b[stride + k] * bases[0][Q] - b[2 * stride + k] * bases[1][Q];
        largest = larger(largest, fabs(left[k]));
    }
    const Point *middle = &ends[0].at, *end = &ends[1].at;
    const double h = work->sample_s * (double)width;
    const double force = fabs(middle->force_q) + fabs(end->force_q) +
                         4.0 * fabs(middle->force_qq * middle->flux) +
                         h * m->pull * (fabs(middle->volts_q) + fabs(end->volts_q));
    const double i = fabs(middle->current_q) + fabs(end->current_q);
    const double least = SMOOTH * m->tolerance;
    rough->any = largest * force * m->per_mass > least * larger(path->largest_a, m->least_a) ||
                 largest * i > least * larger(path->largest_i, m->least_i);
    if (!rough->any)
        return;
    /* The flux that its voltage leaves, and the momentum and way of both forces. */
    const double share = 1.0 / (1.0 - m->from_new * middle->volts_q), each = work->sample_s;
    double flux = 0.0, volts = 0.0, fluxes[MOST_SAMPLES];
    for (size_t k = 0; k < width; k++) {
        const double new_volts = left[k] * (b[k] * path->at_volts_q + b[stride + k] * middle->volts_q +
                                            b[2 * stride + k] * end->volts_q);
        flux = share * (m->kept * flux + m->from_last * volts + m->from_new * new_volts);
        volts = new_volts + middle->volts_q * flux;
        fluxes[k] = flux;
    }
    for (size_t k = 0; k < width; k++) {
        const double force_q = b[k] * path->at_force_q + b[stride + k] * middle->force_q +
                               b[2 * stride + k] * end->force_q;
        const double p = b[k] * path->flux + b[stride + k] * middle->flux +
                         b[2 * stride + k] * end->flux + left[k];
        const double squares = p * p - b[k] * path->flux * path->flux -
                               b[stride + k] * middle->flux * middle->flux -
                               b[2 * stride + k] * end->flux * end->flux;
        rough->a[k] = (force_q * left[k] + middle->force_qq * squares +
                       (m->pull + force_q) * fluxes[k]) * m->per_mass;
    }
    double momentum = 0.0, way = 0.0, before = 0.0;
    for (size_t k = 0; k < width; k++) {
        const double a = rough->a[k];
        way += (momentum + (before * 2.0 + a) * each / 6.0) * each;
        momentum += 0.5 * (before + a) * each;
        before = a;
        if (k + 1 == width / 2 || k + 1 == width) {
            double *d = known[k + 1 == width];
            d[Y] += way;
            d[U] += momentum;
            d[Q] += fluxes[k];
        }
    }
    /* The points have that flux as well: it is not to be counted twice. */
    const double half = fluxes[width / 2 - 1], half_a = rough->a[width / 2 - 1], all_a = before;
    const double twice[2][2] = {{middle->force_q * half, middle->volts_q * half},
                                {end->force_q * flux, middle->volts_q * flux}};
    for (int point = 0; point < 2; point++)
        for (int row = 0; row < n; row++)
            for (int from = 0; from < 2; from++)
                for (int part = 0; part < 2; part++)
                    known[point][row] -= weights[((3 * point + 1 + from) * n + row) * parts + part] *
                                         twice[from][part];
    for (size_t k = 0; k < width; k++) {
        const double current_q = b[k] * path->at_current_q + b[stride + k] * middle->current_q +
                                 b[2 * stride + k] * end->current_q;
        const double more = fluxes[k] - b[stride + k] * half - b[2 * stride + k] * flux;
        rough->i[k] = current_q * left[k] + (current_q + 1.0 / m->inductance) * more;
        rough->a[k] -= b[stride + k] * half_a + b[2 * stride + k] * all_a;
    }
}

/* Solves one step; the number of sweeps, or 0 if it does not converge. */
INLINE int solve(const int n, const Work *work, const Path *path, const double *map, size_t level,
                 size_t at, size_t width, const double bases[2][3], const Third *t, double enough_n,
                 End ends[2], Rough *rough)
{
    const Model *m = work->model;
    const int parts = n > 3 ? PARTS : 2, block = n * parts;
    const double *onward = map + 2, *parabola = onward + 2 * n * n, *cubic = parabola + 6 * block;
    /* Of the cubic through the middle before as well. */
    double weights[6 * STATES * PARTS];
    for (int point = 0; point < 2; point++)
        for (int k = 0; k < block; k++) {
            const int at_node = 3 * block * point + k, third = block * point + k;
            weights[at_node] = parabola[at_node] + t->node * cubic[third];
            weights[at_node + block] = parabola[at_node + block] + t->middle * cubic[third];
            weights[at_node + 2 * block] = parabola[at_node + 2 * block] + t->end * cubic[third];
        }
    const int goes_on = path->width == map[0];
    for (int part = 0; part < 2; part++) {
        const double first = path->before[part], middle = path->middle[part], last = path->g[part];
        ends[0].g[part] = goes_on ? first + 3.0 * (last - middle) : last;
        ends[1].g[part] = goes_on ? 3.0 * first - 8.0 * middle + 6.0 * last : last;
    }
    double known[2][STATES];
    for (int point = 0; point < 2; point++) {
        ends[point].g[PUSH] = n > 3 ? m->mass * base_acceleration(m, bases[point]) : 0.0;
        const double *w = weights + 3 * block * point, *p = onward + n * n * point;
        for (int row = 0; row < n; row++) {
            double sum = 0.0;
            for (int column = 0; column < n; column++)
                sum += p[row * n + column] * path->d[column];
            for (int part = 0; part < parts; part++)
                sum += w[row * parts + part] * path->g[part] +
                       t->before * cubic[block * point + row * parts + part] * path->middle[part];
            known[point][row] = sum;
        }
    }
    const double own[2] = {weights[block + Q * parts + VOLTS],
                           weights[3 * block + 2 * block + Q * parts + VOLTS]};
    double change = 0.0;
    int sweep = 0;
    const int least_sweeps = m->linear != 0.0 ? 1 : 2;
    rough->any = 0;
    for (;;) {
        for (int point = 0; point < 2; point++) {
            const double *w = weights + 3 * block * point + block;
            for (int row = 0; row < n; row++) {
                double sum = known[point][row];
                for (int part = 0; part < parts; part++)
                    sum += w[row * parts + part] * ends[0].g[part] +
                           w[block + row * parts + part] * ends[1].g[part];
                ends[point].d[row] = sum;
            }
        }
        if (sweep >= least_sweeps && change <= enough_n)
            return sweep;
        if (sweep == MOST_SWEEPS || !(change < 1e300))
            return 0;
        change = 0.0;
        for (int point = 0; point < 2; point++) {
            const double force = ends[point].g[FORCE], volts = ends[point].g[VOLTS];
            if (!settle(n, work, bases[point], own[point], &ends[point]))
                return 0;
            change += fabs(ends[point].g[FORCE] - force) +
                      fabs(ends[point].g[VOLTS] - volts) * own[point] * m->pull;
        }
        sweep++;
        if (sweep == 1 && width > 1) {
            double base[PARTS];
            of_base(n, m, path, t, bases, ends, base);
            for (int point = 0; point < 2; point++)
                for (int row = 0; row < n; row++)
                    for (int part = 0; part < parts; part++)
                        known[point][row] -=
                            cubic[block * point + row * parts + part] * base[part];
        }
        if (sweep == 1 && width > 2 && m->linear == 0.0)
            find_rough(n, parts, weights, work, path, level, at, width, bases, ends, known, rough);
    }
}

#endif
