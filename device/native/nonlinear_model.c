/* The non-linear model of the actuator. rig/nonlinear_model.py says the same in NumPy, and what each
 * argument is; rig/equations.py has the equations, rig/step_maps.py the exponentials and tables. */

#include "blocks.h"

#include <math.h>
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
                 size_t at, size_t width, const double bases[2][3], double enough_n, End ends[2],
                 Rough *rough)
{
    const Model *m = work->model;
    const int parts = n > 3 ? PARTS : 2, block = n * parts;
    const double *onward = map + 2, *weights = onward + 2 * n * n;
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
                sum += w[row * parts + part] * path->g[part];
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
        if (sweep == 1 && width > 2 && m->linear == 0.0)
            find_rough(n, parts, weights, work, path, level, at, width, bases, ends, known, rough);
    }
}

/* The linear solution at the middle and the end of a step, and the volts at its end. */
INLINE double find_bases(const Work *work, const Path *path, const double *map, int n, size_t at,
                         size_t width, size_t inner, size_t ticks, double bases[2][3])
{
    const int parts = n > 3 ? PARTS : 2;
    const double *base = map + 2 + 2 * n * n + 7 * n * parts;
    const double per_h = work->model->inductance;
    const size_t last = at + (width ? width - 1 : 0);
    double volts = work->volts[last];
    const int whole = width || inner + ticks == work->ticks;
    if (!whole)
        volts = path->volts + (volts - path->volts) * (double)ticks / (double)(work->ticks - inner);
    for (int point = 0; point < 2; point++) {
        const size_t sample = point ? last : at + width / 2 - 1;
        if (point ? whole : width > 1) {
            for (int row = 0; row < 3; row++)
                bases[point][row] = work->moved[(size_t)row * work->frames + sample];
            bases[point][Q] *= per_h;
            continue;
        }
        for (int row = 0; row < 3; row++) {
            const double *w = base + (3 * point + row) * 5;
            bases[point][row] = w[0] * path->base[0] + w[1] * path->base[1] + w[2] * path->base[2] +
                                w[3] * path->volts + w[4] * volts;
        }
    }
    return volts;
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

/* How far a step is off, over what is allowed. The roughness of the linear solution's flux is known
 * and no error, where it is found. */
INLINE double excess(const Model *m, const Path *path, const Third *t, double width, int smooth,
                     int rough, const double bases[2][3], const End ends[2], double *wrong_a,
                     double odd[2])
{
    const double y = larger(fabs(bases[0][Y] + ends[0].d[Y]), fabs(bases[1][Y] + ends[1].d[Y]));
    const double way = width * fabs(bases[0][U] + ends[0].d[U]);
    const double safety = m->safety * (y + way > m->stop ? CONTACT : rough ? ROUGH : 1.0);
    const double allowed_a = m->tolerance * larger(path->largest_a, m->least_a);
    const double allowed_i = m->tolerance * larger(path->largest_i, m->least_i);
    const double resisting = fabs(third(t, ends[1].at.resisting, ends[0].at.resisting,
                                        path->resisting, path->middle_resisting)) * m->per_mass;
    if (width <= m->fine_s) {
        /* Only stops bend this fast; corners of the voltage are filtered by the coil. */
        odd[0] = odd[1] = 0.0;
        *wrong_a = safety * resisting;
        return *wrong_a / allowed_a;
    }
    double a = third(t, ends[1].a, ends[0].a, path->a, path->middle_a);
    double i = third(t, ends[1].i, ends[0].i, path->i, path->middle_i);
    if (smooth) {
        const double flux = third(t, bases[1][Q], bases[0][Q], path->base[Q], path->middle_q);
        a -= (path->force_q * flux + path->force_qq * squares_of(t, path, ends)) * m->per_mass;
        i -= path->current_q * flux;
    }
    odd[0] = i;
    odd[1] = a;
    *wrong_a = safety * larger(fabs(a), resisting);
    i = fabs(i) * m->safety * (rough ? ROUGH : 1.0);
    return *wrong_a * allowed_i > i * allowed_a ? *wrong_a / allowed_a : i / allowed_i;
}

/* Adds d to the samples of a step. */
INLINE void put(const int n, const Work *work, const Path *path, const End ends[2], const double odd[2],
                const Rough *rough, size_t level, size_t at, size_t width, double h)
{
    const Model *m = work->model;
    const double *d0 = path->d, *d1 = ends[1].d;
    const double *basis = work->bases + level * COLUMNS * work->widest;
    const double w0 = d0[U] - (n > 3 ? d0[FRAME_SPEED] : 0.0);
    const double w1 = d1[U] - (n > 3 ? d1[FRAME_SPEED] : 0.0);
    const double r0 = path->a - path->frame, r1 = ends[1].a - ends[1].frame;
    const double cubics[2][4] = {{d0[Y], d1[Y], h * w0, h * w1}, {w0, w1, h * r0, h * r1}};
    const double through[2][4] = {{path->i, ends[0].i, ends[1].i, odd[0]},
                                  {path->a, ends[0].a, ends[1].a, odd[1]}};
    const double *b[COLUMNS];
    for (int column = 0; column < COLUMNS; column++)
        b[column] = basis + (size_t)column * work->widest;
    for (size_t row = 0; row < 2; row++) {
        double *restrict out = work->moved + row * work->frames + at;
        const double *c = cubics[row];
        if (work->mask >> row & 1)
            for (size_t k = 0; k < width; k++)
                out[k] += b[0][k] * c[0] + b[1][k] * c[1] + b[2][k] * c[2] + b[3][k] * c[3];
    }
    for (size_t row = 2; row < 4; row++) {
        double *restrict out = work->moved + row * work->frames + at;
        const double *c = through[row - 2];
        if (work->mask >> row & 1)
            for (size_t k = 0; k < width; k++)
                out[k] += b[4][k] * c[0] + b[5][k] * c[1] + b[6][k] * c[2] + b[7][k] * c[3];
        const double *more = row == 2 ? rough->i : rough->a;
        if (rough->any && work->mask >> row & 1)
            for (size_t k = 0; k < width; k++)
                out[k] += more[k];
    }
    if (n > 3 && work->mask >> 4 & 1) {
        const double *a = work->moved + 3 * work->frames + at;
        double *out = work->moved + 4 * work->frames + at;
        for (size_t k = 0; k < width; k++) {
            const double z = b[0][k] * d0[FRAME] + b[1][k] * d1[FRAME] +
                             h * (b[2][k] * d0[FRAME_SPEED] + b[3][k] * d1[FRAME_SPEED]);
            const double zs = b[0][k] * d0[FRAME_SPEED] + b[1][k] * d1[FRAME_SPEED] +
                              h * (b[2][k] * path->frame + b[3][k] * ends[1].frame);
            out[k] = -(m->mass * a[k] + m->frame_stiffness * z + m->frame_damping * zs) /
                     m->frame_mass;
        }
    }
}

/* Goes on to the end of a step, with its error by the linear equations. */
INLINE void advance(const int n, const Model *m, Path *path, const double *map, const Third *t,
                    int smooth, const double bases[2][3], const End ends[2], double volts, double wrong_a)
{
    const int parts = n > 3 ? PARTS : 2;
    const double *onward = map + 2 + n * n, *cubic_weights = map + 2 + 2 * n * n + 6 * n * parts;
    double error[STATES], odd[PARTS];
    for (int part = 0; part < parts; part++)
        odd[part] = third(t, ends[1].g[part], ends[0].g[part], path->g[part], path->middle[part]);
    if (smooth) {
        const double flux = third(t, bases[1][Q], bases[0][Q], path->base[Q], path->middle_q);
        odd[FORCE] -= path->force_q * flux + path->force_qq * squares_of(t, path, ends);
        odd[VOLTS] -= path->volts_q * flux;
        if (n > 3)
            odd[PUSH] -= m->pull * flux;
    }
    for (int row = 0; row < n; row++) {
        double old = 0.0, added = 0.0;
        for (int column = 0; column < n; column++)
            old += onward[row * n + column] * path->error[column];
        for (int part = 0; part < parts; part++)
            added += cubic_weights[row * parts + part] * odd[part];
        error[row] = old + added;
        path->d[row] = ends[1].d[row] + added;
    }
    memcpy(path->error, error, sizeof error);
    const double off = m->pull * error[Q] - m->stiffness * error[Y] - m->damping * error[U];
    path->worst_y = larger(path->worst_y, fabs(error[Y]));
    path->worst_a = larger(path->worst_a, fabs(off) * m->per_mass + wrong_a);
    for (int part = 0; part < parts; part++) {
        path->before[part] = path->g[part];
        path->middle[part] = ends[0].g[part];
        path->g[part] = ends[1].g[part];
    }
    memcpy(path->base, bases[1], sizeof path->base);
    path->volts = volts;
    path->a = ends[1].a;
    path->i = ends[1].i;
    path->resisting = ends[1].at.resisting;
    path->frame = ends[1].frame;
    path->middle_a = ends[0].a;
    path->middle_i = ends[0].i;
    path->middle_resisting = ends[0].at.resisting;
    path->width = map[0];
    path->middle_q = bases[0][Q];
    path->force_q = ends[0].at.force_q;
    path->volts_q = ends[0].at.volts_q;
    path->current_q = ends[0].at.current_q;
    path->flux = ends[1].at.flux;
    path->middle_flux = ends[0].at.flux;
    path->force_qq = ends[0].at.force_qq;
    path->at_force_q = ends[1].at.force_q;
    path->at_volts_q = ends[1].at.volts_q;
    path->at_current_q = ends[1].at.current_q;
    const double kept = 1.0 - map[1];
    const double a = larger(fabs(ends[0].at.acceleration), fabs(ends[1].at.acceleration));
    path->largest_a = larger(path->largest_a * kept, a);
    path->largest_i = larger(path->largest_i * kept, fabs(ends[1].at.current));
    const double y = larger(fabs(bases[0][Y] + ends[0].d[Y]), fabs(bases[1][Y] + ends[1].d[Y]));
    path->peak_y = larger(path->peak_y, y);
    path->peak_a = larger(path->peak_a, a);
}

/* g at the node where a path begins. */
INLINE int begin(const int n, const Work *work, Path *path)
{
    const Model *m = work->model;
    End end = {.a = 0.0};
    memcpy(end.d, path->d, sizeof end.d);
    end.g[PUSH] = n > 3 ? m->mass * base_acceleration(m, path->base) : 0.0;
    if (!settle(n, work, path->base, 0.0, &end))
        return 0;
    show(n, m, path->base, &end);
    memcpy(path->g, end.g, sizeof path->g);
    memcpy(path->middle, end.g, sizeof path->middle);
    memcpy(path->before, end.g, sizeof path->before);
    path->a = path->middle_a = end.a;
    path->i = path->middle_i = end.i;
    path->resisting = path->middle_resisting = end.at.resisting;
    path->frame = end.frame;
    path->width = work->maps[0];
    path->middle_q = path->base[Q];
    path->flux = path->middle_flux = end.at.flux;
    path->force_qq = end.at.force_qq;
    path->force_q = path->at_force_q = end.at.force_q;
    path->volts_q = path->at_volts_q = end.at.volts_q;
    path->current_q = path->at_current_q = end.at.current_q;
    path->fresh = 0.0;
    return 1;
}

INLINE void report(const Work *work, Path *path, size_t block)
{
    double *row = work->report + 4 * block;
    row[0] = path->peak_y;
    row[1] = path->peak_a;
    row[2] = path->worst_y;
    row[3] = path->worst_a;
    path->peak_y = path->peak_a = path->worst_y = path->worst_a = 0.0;
}

/* Solves the samples from start to stop; how many it did before a step did not converge. */
INLINE size_t run(const int n, const Work *work, Path *path, size_t start, size_t stop, size_t first,
                  size_t each)
{
    const Model *m = work->model;
    size_t at = start, inner = 0, next = start + first, block = 0;
    size_t shortest_whole = 0;
    while (work->widest >> shortest_whole > 1)
        shortest_whole++;
    Path kept = *path;
    if (path->fresh != 0.0 && !begin(n, work, path))
        return 0;
    while (at < stop) {
        size_t level = (size_t)path->level;
        if (!inner && level > shortest_whole)
            kept = *path;
        if (inner && level <= shortest_whole)
            level = shortest_whole + 1;
        size_t width = 0, ticks = 0;
        for (;; level++) {
            if (level <= shortest_whole) {
                width = work->widest >> level;
                if ((at - start) % width == 0 && at + width <= stop)
                    break;
            } else {
                width = 0;
                ticks = work->ticks >> (level - shortest_whole);
                if (inner % ticks == 0)
                    break;
            }
        }
        const double *map = work->maps + level * work->map_size;
        double bases[2][3], odd[2], wrong_a = 0.0;
        End ends[2];
        Rough rough;
        const double volts = find_bases(work, path, map, n, at, width, inner, ticks, bases);
        const double enough_n = ENOUGH * m->tolerance * larger(path->largest_a, m->least_a) * m->mass;
        const int sweeps = solve(n, work, path, map, level, at, width, bases, enough_n, ends, &rough);
        const Third t = third_of(map[0], path->width);
        double over = HUGE_VAL;
        if (sweeps) {
            for (int point = 0; point < 2; point++)
                show(n, m, bases[point], &ends[point]);
            over = excess(m, path, &t, map[0], width > 1, rough.any, bases, ends, &wrong_a, odd);
        }
        path->sweeps += sweeps ? sweeps : MOST_SWEEPS;
        path->steps += 1.0;
        if (!(over <= 1.0) && level + 1 < work->levels) {
            path->level = (double)(level + 1);
            continue;
        }
        if (!sweeps) {
            if (inner || level > shortest_whole)
                *path = kept;
            return at - start;
        }
        if (width > 1)
            put(n, work, path, ends, odd, &rough, level, at, width, map[0]);
        else if (width || inner + ticks == work->ticks)
            put(n, work, path, ends, odd, &rough, shortest_whole, at, 1, map[0]);
        advance(n, m, path, map, &t, width > 1, bases, ends, volts, wrong_a);
        if (over < GROW && level && level == (size_t)path->level)
            path->level = (double)(level - 1);
        at += width;
        inner += width ? 0 : ticks;
        if (inner == work->ticks) {
            inner = 0;
            at++;
        }
        if (at == next && !inner) {
            report(work, path, block++);
            next += each;
        }
    }
    return at - start;
}

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
    for (size_t at = start; at < stop; at += work->widest) {
        double bases[2][3], linear[2][STATES] = {{0}}, born[2][STATES] = {{0}};
        double g[3][PARTS];
        End end = {.a = 0.0};
        const double volts =
            find_bases(work, path, map, n, at, work->widest, 0, work->ticks, bases);
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

const char nonlinear_motion_doc[] = "Add the non-linear model's answer; see _blocks.pyi.";
const char linear_suffices_doc[] = "Count the blocks that may be linear; see _blocks.pyi.";

enum { VOLTAGE, MOVED, MODEL, TABLE, MAPS, BASES, STATE, REPORT, TWO, ARRAYS };
static const char *const NAMES[ARRAYS] = {"volts",  "moved", "model",  "table", "maps",
                                          "bases",  "path",  "report", "pair"};

static const char *misfit_of(const Py_buffer *v, const size_t *n, int arrays)
{
    const size_t states = v[MODEL].ndim == 1 && v[MOVED].ndim == 2 ? (size_t)v[MOVED].shape[0] : 0;
    const size_t frames = states ? (size_t)v[MOVED].shape[1] : 0;
    const size_t each = n[3], start = n[0], stop = n[1], first = n[2];
    const size_t reports = each && stop > start + first ? 1 + (stop - start - first) / each : 1;
    if (v[VOLTAGE].ndim != 1 || states != 5 || (size_t)v[VOLTAGE].shape[0] != frames)
        return "volts and moved: not (frames,) and (5, frames)";
    if (start > stop || stop > frames || !first || !each)
        return "start, stop: no part of the volts, or blocks without frames";
    if (v[MODEL].len != sizeof(Model) || v[STATE].len != sizeof(Path))
        return "model or path: of another length";
    if (v[TABLE].ndim != 2 || v[TABLE].shape[1] != 16)
        return "table: not (intervals, 16)";
    if ((double)v[TABLE].shape[0] < ((const Model *)v[MODEL].buf)->intervals)
        return "table: fewer intervals than the model says";
    if (v[MAPS].ndim != 2 || v[BASES].ndim != 3 || v[BASES].shape[1] != COLUMNS)
        return "maps and bases: not (levels, numbers) and (levels, 8, samples)";
    const size_t widest = (size_t)v[BASES].shape[2], whole = (size_t)v[BASES].shape[0];
    if (!whole || whole > 24 || widest != (size_t)1 << (whole - 1) ||
        (size_t)v[MAPS].shape[0] < whole || (size_t)v[MAPS].shape[0] > whole + 24)
        return "bases: not one level for each halving to a sample";
    if (v[MAPS].shape[1] != 2 + 18 + 42 + 30 && v[MAPS].shape[1] != 2 + 50 + 105 + 30)
        return "maps: for neither 3 nor 5 states";
    if (((const Path *)v[STATE].buf)->level < 0.0 ||
        !(((const Path *)v[STATE].buf)->level < (double)v[MAPS].shape[0]))
        return "path: at no level";
    if (v[REPORT].ndim != 2 || v[REPORT].shape[1] != 4 || (size_t)v[REPORT].shape[0] < reports)
        return "report: not (blocks, 4) for all blocks";
    if (arrays == ARRAYS && (v[TWO].len != sizeof(Pair) || widest < 2 || first % widest ||
                             each % widest || (stop - start - first) % each))
        return "pair: not (2, 5), or blocks of a part of a step";
    return NULL;
}

static PyObject *on_arrays(PyObject *const *arguments, Py_ssize_t count_given, int arrays)
{
    Py_buffer views[ARRAYS];
    size_t numbers[5] = {0};
    if (count_given != arrays + 5) {
        PyErr_SetString(PyExc_TypeError, "takes the arrays, then five numbers");
        return NULL;
    }
    for (int k = 0; k < 4; k++) {
        numbers[k] = PyLong_AsSize_t(arguments[arrays + k]);
        if (PyErr_Occurred())
            return NULL;
    }
    const double last = PyFloat_AsDouble(arguments[arrays + 4]);
    if (PyErr_Occurred())
        return NULL;
    int open = 0;
    while (open < arrays) {
        const int writable = open == MOVED || open == STATE || open == REPORT || open == TWO;
        if (!opened(arguments[open], NAMES[open], "d", writable, &views[open]))
            break;
        open++;
    }
    PyObject *done = NULL;
    if (open == arrays) {
        const char *misfit = misfit_of(views, numbers, arrays);
        if (misfit) {
            PyErr_SetString(PyExc_ValueError, misfit);
        } else {
            Work work = {.model = views[MODEL].buf, .table = views[TABLE].buf,
                         .maps = views[MAPS].buf, .bases = views[BASES].buf,
                         .volts = views[VOLTAGE].buf, .moved = views[MOVED].buf,
                         .report = views[REPORT].buf, .frames = (size_t)views[VOLTAGE].shape[0],
                         .levels = (size_t)views[MAPS].shape[0],
                         .map_size = (size_t)views[MAPS].shape[1],
                         .widest = (size_t)views[BASES].shape[2]};
            work.sample_s = *(const double *)work.maps / (double)work.widest;
            work.ticks = (size_t)1 << (work.levels - (size_t)views[BASES].shape[0]);
            Path *path = views[STATE].buf;
            const size_t start = numbers[0], stop = numbers[1], first = numbers[2], each = numbers[3];
            const int large = work.map_size > 100;
            size_t found;
            if (arrays == ARRAYS) {
                Pair *pair = views[TWO].buf;
                found = large ? count(5, &work, path, pair, start, stop, first, each, last)
                              : count(3, &work, path, pair, start, stop, first, each, last);
            } else {
                work.mask = (size_t)last;
                found = large ? run(5, &work, path, start, stop, first, each)
                              : run(3, &work, path, start, stop, first, each);
            }
            done = PyLong_FromSize_t(found);
        }
    }
    while (open)
        PyBuffer_Release(&views[--open]);
    return done;
}

PyObject *nonlinear_motion(PyObject *Py_UNUSED(module), PyObject *const *arguments, Py_ssize_t count)
{
    return on_arrays(arguments, count, TWO);
}

PyObject *linear_suffices(PyObject *Py_UNUSED(module), PyObject *const *arguments, Py_ssize_t count)
{
    return on_arrays(arguments, count, ARRAYS);
}
