/* How strong a channel vibrates, tick by tick; tests/oracle/strength.py has it to read. */

#include "strength.h"

#include "exact.h"

/* Decibels of a level that doubles with every 10 phon, for each factor 10 of sone. */
#define DB_A_DECADE 33.219280948873624

/* A smaller deviation is set to 0, before it becomes denormal and slow. */
#define STILL 1e-30

void strength_reset(const Settings *s, Strength *strength)
{
    strength->programme = s->programme_start;
    strength->sound_ticks = 0.0;
    strength_rest(s, strength);
}

void strength_rest(const Settings *s, Strength *strength)
{
    const double programme = strength->programme, sound_ticks = strength->sound_ticks;
    memset(strength, 0, sizeof *strength);
    strength->programme = programme;
    strength->sound_ticks = sound_ticks;
    strength->floor = strength->loud = strength->steady = strength->slow = s->floor_min;
    strength->speech_left = 1.0;
    strength->usual = s->silence_db;
    for (size_t group = 0; group < GROUPS_OF_BANDS_MAX; group++) {
        strength->usual_of[group] = s->silence_db;
        strength->deviation[group] = s->deviation_start;
    }
}

/* How far the soft gate over the background noise is open, 0 to 1. */
static double open_gate(const Settings *s, const Strength *strength)
{
    const double under = smaller(strength->floor, strength->programme - s->floor_under);
    const double over = smaller(1.0, (strength->steady - larger(s->floor_min, under)) / s->gate);
    return over >= s->gate_margin ? over * over * (3.0 - 2.0 * over) : 0.0;
}

/* Let the programme's level go towards the loudness; at the beginning of a stream it is found fast. */
static void move_programme(const Settings *s, Strength *strength, double gate)
{
    const double above = strength->loud - strength->programme;
    const double missing = clip(above, -s->far, s->far);
    double move = clip(above, -1.0, 1.0) * s->programme_step +
                  missing * (missing > 0.0 ? s->programme_rise : s->programme_fall);
    if (strength->sound_ticks < s->start_ticks) {
        strength->sound_ticks += 1.0;
        move += clip(above + s->start_near, -s->far, 0.0) / (s->start_weight + strength->sound_ticks);
    }
    strength->programme = clip(strength->programme + gate * move, s->programme_min, s->programme_top);
}

/* Return what is wanted for the group of bands that rose most, in dB, and let all go on. */
static double wanted_rise(const Settings *s, Strength *strength, const Loudness *loudness)
{
    double wanted = 0.0;
    for (size_t group = 0; group + 1 < s->loudness_groups.length; group++) {
        double *smooth = &strength->smooth[group], *deviation = &strength->deviation[group];
        *smooth += s->group_smooth * (loudness->groups[group] - *smooth);
        if (*smooth < STILL)
            *smooth = 0.0;
        const double level = DB_A_DECADE * exact_log10(*smooth + s->group_sone);
        const double rise = level - strength->usual_of[group];
        const double over = rise - s->boost_deviations * *deviation;
        if (over > 0.0) {
            const double share = loudness->groups[group] / (loudness->sone + s->nothing);
            const double counts = clip((share - s->boost_share_from) / s->boost_share_width, 0.0, 1.0);
            wanted = larger(wanted, smaller(s->boost_max, s->boost_slope * counts * over));
        }
        *deviation += s->group_deviates * (smaller(s->deviation_max, fabs(rise)) - *deviation);
        if (*deviation < STILL)
            *deviation = 0.0;
        strength->usual_of[group] += rise * (rise > 0.0 ? s->group_up : s->group_down);
    }
    return wanted;
}

/* Let a rise that the loudness of all bands hardly shows be felt at once. */
static void boost(const Settings *s, Strength *strength, double wanted)
{
    const double above = strength->steady - strength->usual;
    const double natural = s->slope * above;
    const double extra = larger(0.0, wanted - larger(0.0, natural) - s->boost_natural);
    strength->usual += above * (above > 0.0 ? s->group_up : s->group_down);
    if (extra >= strength->boost) {
        strength->boost = extra;
        strength->held_ticks = s->boost_hold_ticks;
        return;
    }
    strength->held_ticks = larger(0.0, strength->held_ticks - 1.0);
    if (strength->held_ticks == 0.0)
        strength->boost = larger(extra, strength->boost - s->boost_fall);
}

double strength_follow(const Settings *s, Strength *strength, const Loudness *loudness)
{
    const double change = loudness->db - strength->steady;
    if (change > s->jump)
        strength->attack_ticks = s->attack_ticks;
    const double jitter = strength->attack_ticks > 0.0 ? 0.0 : s->jitter;
    const double small = clip(change, -jitter, jitter);
    strength->attack_ticks = larger(0.0, strength->attack_ticks - 1.0);
    strength->steady += (change - small) + s->jitter_followed * small;
    strength->slow += s->slow_followed * (strength->steady - strength->slow);
    strength->floor = larger(s->floor_min, smaller(strength->floor + s->floor_rise, strength->steady));
    strength->loud = larger(larger(s->floor_min, strength->loud - s->release), strength->slow);
    const double gate = open_gate(s, strength);
    if (gate > 0.0)
        move_programme(s, strength, gate);
    boost(s, strength, wanted_rise(s, strength, loudness));
    if (!(gate > 0.0))
        return 0.0;
    const double level = s->target + s->slope * (strength->steady - strength->programme);
    return gate * strength->speech_left * exact_amplitude(level + strength->boost * strength->speech_left);
}

int strength_is_possible(const Settings *s, const Strength *strength)
{
    const double *numbers = (const double *)strength;
    for (size_t one = 0; one < STRENGTH_STATES; one++)
        if (!isfinite(numbers[one]))
            return 0;
    return strength->programme >= s->programme_min && strength->programme <= s->programme_top &&
           strength->attack_ticks >= 0.0 && strength->boost >= 0.0 &&
           strength->boost <= s->boost_max && strength->sound_ticks >= 0.0 &&
           strength->speech_left >= 0.0 && strength->speech_left <= 1.0;
}
