/* The rig's two models. The linear model is exact if the voltage is linear between samples. A fourth-order
 * Runge-Kutta method solves the equations of the non-linear model. device/rig/equations.py has the equations;
 * device/rig/adaptive_actuator.py computes the parameters and tables. */

#pragma once

#include <math.h>
#include <stddef.h>
#include <string.h>

#define INLINE static inline __attribute__((always_inline))
#define MOST_STATES 5

/* States in SI units: excursion, speed of the moving mass, flux of the current; with a seat, also the frame's
 * position and speed. */
enum { Y, U, Q, FRAME, FRAME_SPEED };
enum { FORCE, VOLTS };

/* Parameters in SI units, in the order of `ModelDesign` in device/rig/adaptive_actuator.py. */
typedef struct {
    double mass, damping, stiffness, force_factor, inductance; /* values of the linear model */
    double ohm, ohm_at_rest;
    double stop_m, stop_n_per_m2, stop_loss_s_per_m, contact_mass, contact_turn;
    double lowest_m, intervals_per_m, intervals; /* grid of Work.table over the excursion */
    double frame_mass, frame_stiffness, frame_damping;
    double least_y, least_a, tolerance, margin; /* least_: lower limits of peaks; margin: factor on errors */
    double sample_s, levels, first_level, coarse;
} Model;

/* The state after a sample. `residual` and `correction` are from `since` samples ago. residual: force and
 * voltage that the linear model neglected. correction: the linear model's response to all neglected forces
 * and voltages. */
typedef struct {
    double s[MOST_STATES], volts, correction[MOST_STATES], residual[2], since;
    double is_linear; /* 1: the flux is that of the linear model */
    double failed_peak_y, blocks_to_skip; /* set when the linear model's error exceeds the tolerance */
    double unresolved; /* frames with an end stop too stiff for the shortest step, or a diverged state */
} State;

typedef struct {
    const Model *model;
    const double *table, *steps, *volts;
    /* Matrices that give the next state from the state, the last input and the new input. by_sample: for a
     * step of 1 sample; input: voltage. by_coarse: for a step of `coarse` samples; input: the residual. */
    const double *by_sample, *by_coarse;
    double *moved;
    size_t frames;
} Work;

/* Coefficients of a step with exact decay of the flux (ETDRK4, Cox and Matthews 2002). kept: remaining share
 * of the flux. level, slope: flux per V and per V/s. half_: the same coefficients for half a step. middle,
 * last: weights of the stages' deviations from a linear change of the flux's input. decay_slope,
 * factor_slope: derivatives of decay_per_s and of the force factor with respect to the excursion; 0:
 * neglected. */
typedef struct {
    double width_s, decay_per_s, decay_slope, factor_slope;
    double half_kept, half_level, half_slope, kept, level, slope, middle, last;
} Step;

INLINE double cubic(const double *c, double t) { return c[0] + t * (c[1] + t * (c[2] + t * c[3])); }

INLINE double cubic_slope(const double *c, double t) { return c[1] + t * (2.0 * c[2] + t * 3.0 * c[3]); }

/* Interpolate force factor, 1 / L, L' / 2 and spring force at excursion y, and the slopes of the first two.
 * L: inductance. Outside the table, the spring force is linear, the slopes are 0, the rest is constant. */
INLINE void look_up(const Model *m, const double *table, double y, double found[6])
{
    double place = (y - m->lowest_m) * m->intervals_per_m, beyond = 0.0;
    if (!(place >= 0.0)) {
        beyond = place;
        place = 0.0;
    } else if (place >= m->intervals) {
        beyond = place - m->intervals;
        place = m->intervals;
    }
    size_t interval = (size_t)place;
    if (interval == (size_t)m->intervals)
        interval--;
    const double t = place - (double)interval, *row = table + 16 * interval;
    for (int k = 0; k < 4; k++)
        found[k] = cubic(row + 4 * k, t);
    if (beyond != 0.0)
        found[3] += beyond * cubic_slope(row + 12, t);
    for (int k = 0; k < 2; k++)
        found[4 + k] = beyond != 0.0 ? 0.0 : cubic_slope(row + 4 * k, t) * m->intervals_per_m;
}

/* Time derivatives of the states; current and force factor. The derivative of the flux does not contain the
 * term -decay_per_s * flux. */
typedef struct {
    double of[MOST_STATES], current, force_factor;
} Rates;

INLINE void find_rates(const int n, const Model *m, const double *table, const double *s, double volts,
                       double decay_per_s, Rates *rates)
{
    double *rate = rates->of;
    double at[6];
    look_up(m, table, s[Y], at);
    const double w = n > 3 ? s[U] - s[FRAME_SPEED] : s[U], depth = fabs(s[Y]) - m->stop_m;
    const double current = s[Q] * at[1];
    double force = (at[0] + at[2] * current) * current - at[3] - m->damping * w;
    rates->current = current;
    rates->force_factor = at[0];
    if (depth > 0.0) {
        const double pressed = m->stop_n_per_m2 * depth * depth;
        force -= copysign(pressed, s[Y]) + m->stop_loss_s_per_m * pressed * w;
    }
    rate[Y] = w;
    rate[U] = force / m->mass;
    rate[Q] = volts - (m->ohm * at[1] - decay_per_s) * s[Q] - at[0] * w;
    if (n > 3) {
        rate[FRAME] = s[FRAME_SPEED];
        rate[FRAME_SPEED] = -(force + m->frame_stiffness * s[FRAME] +
                              m->frame_damping * s[FRAME_SPEED]) / m->frame_mass;
    }
}

/* Advance the state by one step, in which the volts change linearly. first: rates at the start. The rate of
 * the flux, without decay, is the sum of a linear prediction, made at the start, and a deviation. */
INLINE void make_step(const int n, const Model *m, const double *table, const Step *h, const Rates *first,
                      double before_v, double end_v, double *s)
{
    Rates second, third, last;
    const double *a = first->of, *b = second.of, *c = third.of, *d = last.of;
    const double width_s = h->width_s, half_s = 0.5 * width_s, middle_v = 0.5 * (before_v + end_v);
    const double slope = (end_v - before_v) / width_s -
                         first->force_factor * (n > 3 ? a[U] - a[FRAME_SPEED] : a[U]) -
                         (h->factor_slope * a[Y] + h->decay_slope * s[Q]) * a[Y];
    const double in_middle = a[Q] + half_s * slope;
    const double flux_middle = h->half_kept * s[Q] + h->half_level * a[Q] + h->half_slope * slope;
    const double flux_end = h->kept * s[Q] + h->level * a[Q] + h->slope * slope;
    double x[MOST_STATES];
    for (int k = 0; k < n; k++)
        x[k] = s[k] + half_s * a[k];
    x[Q] = flux_middle;
    find_rates(n, m, table, x, middle_v, h->decay_per_s, &second);
    for (int k = 0; k < n; k++)
        x[k] = s[k] + half_s * b[k];
    x[Q] = flux_middle + h->half_level * (b[Q] - in_middle);
    find_rates(n, m, table, x, middle_v, h->decay_per_s, &third);
    for (int k = 0; k < n; k++)
        x[k] = s[k] + width_s * c[k];
    x[Q] = flux_end + 2.0 * h->half_level * (c[Q] - in_middle);
    find_rates(n, m, table, x, end_v, h->decay_per_s, &last);
    for (int k = 0; k < n; k++)
        s[k] += width_s / 6.0 * (a[k] + 2.0 * (b[k] + c[k]) + d[k]);
    s[Q] = flux_end + h->middle * (b[Q] + c[Q] - 2.0 * in_middle) +
           h->last * (d[Q] - a[Q] - width_s * slope);
}

/* Return a step's coefficients at excursion y. If the flux decays below 1/e in a step, the usual coefficients
 * are inaccurate, because the method's stages lag behind a change of the decay. */
INLINE Step step_at(const Model *m, const double *table, double y, const Step *usual)
{
    if (usual->width_s * usual->decay_per_s <= 1.0)
        return *usual;
    double at[6];
    look_up(m, table, y, at);
    const double h = usual->width_s, decay_per_s = m->ohm * at[1], z = h * decay_per_s;
    const double half_kept = exp(-0.5 * z), half = (1.0 - half_kept) / (0.5 * z), kept = exp(-z);
    const double one = (1.0 - kept) / z, two = (1.0 - one) / z, three = (0.5 - two) / z;
    return (Step){h, decay_per_s, m->ohm * at[5], at[4],
                  half_kept, 0.5 * h * half, 0.5 * h * h * (1.0 - half) / z, kept, h * one, h * h * two,
                  h * (2.0 * two - 4.0 * three), h * (4.0 * three - two)};
}

/* Return the largest indentation of an end stop, m, that steps of h->width_s resolve. */
INLINE double deepest(const Model *m, const Step *h)
{
    const double rad_s = m->contact_turn / h->width_s;
    return rad_s * rad_s * m->contact_mass / (2.0 * m->stop_n_per_m2);
}

/* Return the lowest level from first_level on that resolves an end-stop contact; `levels` if none does.
 * Level n has 2^n steps per sample. */
INLINE size_t contact_level(const Model *m, const double *s, const double *rate, const Step *steps)
{
    const size_t first = (size_t)m->first_level, levels = (size_t)m->levels;
    const double speed = fabs(rate[Y]) + m->sample_s * fabs(rate[U]);
    if (!(fabs(s[Y]) + m->sample_s * speed > m->stop_m) || m->stop_n_per_m2 == 0.0)
        return first;
    const double depth = fabs(s[Y]) > m->stop_m ? fabs(s[Y]) - m->stop_m : 0.0;
    const double reached = depth * depth * depth +
                           1.5 * m->contact_mass * speed * speed / m->stop_n_per_m2;
    for (size_t level = first; level < levels; level++) {
        const double most = deepest(m, steps + level);
        if (most * most * most >= reached)
            return level;
    }
    return levels;
}

/* At an end stop too stiff for the shortest step, clamp the excursion and set the relative speed to 0. */
INLINE void hold_at_wall(const int n, const Model *m, const Step *h, double *s)
{
    const double wall = m->stop_m + deepest(m, h);
    if (fabs(s[Y]) > wall) {
        s[Y] = copysign(wall, s[Y]);
        s[U] = n > 3 ? s[FRAME_SPEED] : 0.0;
    }
}

/* Return whether the state has diverged; the rig then restarts from rest. */
INLINE int is_lost_state(const int n, const double *s)
{
    for (int k = 0; k < n; k++)
        if (!(fabs(s[k]) < 1e12))
            return 1;
    return 0;
}

INLINE void write_sample(const int n, const Work *w, size_t frame, const double *s, const double *rate,
                         double current)
{
    double *moved = w->moved + frame;
    moved[0] = s[Y];
    moved[w->frames] = rate[Y];
    moved[2 * w->frames] = current;
    moved[3 * w->frames] = rate[U];
    if (n > 3)
        moved[4 * w->frames] = rate[FRAME_SPEED];
}

/* Run the non-linear model, with one or more steps per sample; return the largest |excursion|. */
INLINE double run_runge_kutta(const int n, const Work *w, State *at, size_t start, size_t stop)
{
    const Model *m = w->model;
    const Step *steps = (const Step *)w->steps;
    const size_t levels = (size_t)m->levels;
    double s[MOST_STATES], before = at->volts, peak_y = 0.0;
    Rates rates;
    memcpy(s, at->s, sizeof s);
    find_rates(n, m, w->table, s, before, steps->decay_per_s, &rates);
    for (size_t frame = start; frame < stop; frame++) {
        const double volts = w->volts[frame];
        size_t level = contact_level(m, s, rates.of, steps);
        const int is_wall = level == levels;
        level -= (size_t)is_wall;
        const size_t parts = (size_t)1 << level;
        const double each = (volts - before) / (double)parts;
        for (size_t part = 0; part < parts; part++) {
            const double from = before + each * (double)part;
            const Step h = step_at(m, w->table, s[Y], steps + level);
            if (part || h.decay_per_s != steps->decay_per_s)
                find_rates(n, m, w->table, s, from, h.decay_per_s, &rates);
            make_step(n, m, w->table, &h, &rates, from, from + each, s);
            if (is_wall)
                hold_at_wall(n, m, &h, s);
        }
        const int is_lost = is_lost_state(n, s);
        if (is_lost)
            memset(s, 0, sizeof s);
        at->unresolved += is_wall || is_lost;
        before = volts;
        find_rates(n, m, w->table, s, before, steps->decay_per_s, &rates);
        write_sample(n, w, frame, s, rates.of, rates.current);
        peak_y = fabs(s[Y]) > peak_y ? fabs(s[Y]) : peak_y;
    }
    memcpy(at->s, s, sizeof s);
    at->volts = before;
    return peak_y;
}

/* Run the linear model, with one exact step per sample; increase `peaks` to the largest |excursion| and
 * |acceleration of the moving mass|. */
INLINE void run_linear(const int n, const Work *w, State *at, size_t start, size_t stop, double peaks[2])
{
    const Model *m = w->model;
    const double *onward = w->by_sample, *by_last = onward + n * n, *by_new = by_last + n;
    const double per_h = 1.0 / m->inductance, pull = m->force_factor * per_h, per_mass = 1.0 / m->mass;
    double s[MOST_STATES], before = at->volts, peak_y = peaks[0], peak_a = peaks[1];
    memcpy(s, at->s, sizeof s);
    for (size_t frame = start; frame < stop; frame++) {
        const double volts = w->volts[frame];
        double next[MOST_STATES];
        for (int row = 0; row < n; row++) { /* two sums shorten the dependency chain */
            const double *p = onward + row * n;
            const double others = n > 3 ? p[3] * s[3] + p[4] * s[4] : 0.0;
            next[row] = (by_last[row] * before + by_new[row] * volts + others + p[0] * s[0]) +
                        (p[1] * s[1] + p[2] * s[2]);
        }
        memcpy(s, next, sizeof s);
        before = volts;
        double rate[MOST_STATES];
        rate[Y] = n > 3 ? s[U] - s[FRAME_SPEED] : s[U];
        const double force = pull * s[Q] - m->stiffness * s[Y] - m->damping * rate[Y];
        rate[U] = force * per_mass;
        if (n > 3)
            rate[FRAME_SPEED] = -(force + m->frame_stiffness * s[FRAME] +
                                  m->frame_damping * s[FRAME_SPEED]) / m->frame_mass;
        peak_y = fabs(s[Y]) > peak_y ? fabs(s[Y]) : peak_y;
        peak_a = fabs(rate[U]) > peak_a ? fabs(rate[U]) : peak_a;
        write_sample(n, w, frame, s, rate, s[Q] * per_h);
    }
    memcpy(at->s, s, sizeof s);
    at->volts = before;
    peaks[0] = peak_y;
    peaks[1] = peak_a;
}
