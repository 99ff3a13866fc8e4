/* A path of steps: each one's error, its length and the samples that it fills. */

#ifndef DEVICE_NONLINEAR_PATH_H
#define DEVICE_NONLINEAR_PATH_H

#include "nonlinear_step.h"

/* The linear solution at the middle and the end of a step, and the volts at its end. */
INLINE double find_bases(const Work *work, const Path *path, const double *map, int n, size_t at,
                         size_t width, size_t inner, size_t ticks, double bases[2][3])
{
    const int parts = n > 3 ? PARTS : 2;
    const double *base = map + 2 + 2 * n * n + 8 * n * parts;
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
    const double *onward = map + 2 + n * n, *cubic_weights = map + 2 + 2 * n * n + 7 * n * parts;
    double error[STATES], odd[PARTS], base[PARTS] = {0.0};
    if (smooth)
        of_base(n, m, path, t, bases, ends, base);
    for (int part = 0; part < parts; part++)
        odd[part] = third(t, ends[1].g[part], ends[0].g[part], path->g[part], path->middle[part]) -
                    base[part];
    for (int row = 0; row < n; row++) {
        double old = 0.0, added = 0.0; /* by the cubic: what the parabola would be off */
        for (int column = 0; column < n; column++)
            old += onward[row * n + column] * path->error[column];
        for (int part = 0; part < parts; part++)
            added += cubic_weights[row * parts + part] * odd[part];
        error[row] = old + added;
        path->d[row] = ends[1].d[row];
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
        const Third t = third_of(map[0], path->width);
        const int sweeps = solve(n, work, path, map, level, at, width, bases, &t, enough_n, ends, &rough);
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

#endif
