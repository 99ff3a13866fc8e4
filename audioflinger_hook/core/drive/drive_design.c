/* Reads the drives of a design; device/drive/design.py writes them. */

#include "actuator.h"

#include <stdio.h>

#define COUNT_MAX 65536

/* Lengths of tables, in which `d` is the drive, `p` its protection and `e` its exposure. */
#define DRIVE_COUNTS(ENTRY)                                                                        \
    ENTRY(damping.count) ENTRY(protection.models) ENTRY(protection.states)                         \
    ENTRY(protection.frames) ENTRY(protection.watched) ENTRY(protection.stride)                    \
    ENTRY(protection.tail_points) ENTRY(protection.currents) ENTRY(protection.hold_blocks)         \
    ENTRY(exposure.factor) ENTRY(exposure.decimation_taps) ENTRY(exposure.motion_taps)             \
    ENTRY(exposure.motion.count) ENTRY(exposure.weighting.count) ENTRY(exposure.above.count)       \
    ENTRY(exposure.reading_frames)

#define DRIVE_NUMBERS(ENTRY)                                                                       \
    ENTRY(damping_gain) ENTRY(protection.swing_m) ENTRY(protection.level)                          \
    ENTRY(protection.current_a) ENTRY(protection.recovery) ENTRY(protection.release)               \
    ENTRY(protection.notice) ENTRY(protection.forget) ENTRY(protection.caution)                    \
    ENTRY(protection.hottest_k) ENTRY(protection.ambient_c) ENTRY(protection.resistance_ohm)       \
    ENTRY(protection.resistance_per_k) ENTRY(protection.coil_k_per_w)                              \
    ENTRY(protection.coil_j_per_k) ENTRY(protection.approach_s)                                    \
    ENTRY(exposure.m_s2_per_full_scale) ENTRY(exposure.period_s) ENTRY(exposure.running_share)     \
    ENTRY(exposure.cap_a8_m_s2) ENTRY(exposure.cap_vdv)

#define DRIVE_TABLES(ENTRY)                                                                        \
    ENTRY(damping.sections, SECTION_NUMBERS * d->damping.count)                                    \
    ENTRY(protection.excursion_by_drive, p->models * ROW_FRAMES(p->frames))                        \
    ENTRY(protection.excursion_by_state, p->models * p->states * WHOLE_LANES(p->watched))          \
    ENTRY(protection.state_by_drive, p->models * p->states * ROW_FRAMES(p->frames))                \
    ENTRY(protection.state_by_state, p->models * p->states * WHOLE_LANES(p->states))               \
    ENTRY(protection.current_by_drive, p->currents * ROW_FRAMES(p->frames))                        \
    ENTRY(protection.current_by_state, p->currents * p->states * WHOLE_LANES(p->frames))           \
    ENTRY(protection.tail_by_state, p->models * p->states * WHOLE_LANES(p->tail_points))           \
    ENTRY(protection.reach, p->models)                                                             \
    ENTRY(protection.swing, p->models)                                                             \
    ENTRY(protection.last_kick, p->models)                                                         \
    ENTRY(protection.ring, p->models)                                                              \
    ENTRY(exposure.decimation, e->decimation_taps)                                                 \
    ENTRY(exposure.motion.sections, SECTION_NUMBERS * e->motion.count)                             \
    ENTRY(exposure.motion_fir, e->motion_taps)                                                     \
    ENTRY(exposure.weighting.sections, SECTION_NUMBERS * e->weighting.count)                       \
    ENTRY(exposure.above.sections, SECTION_NUMBERS * e->above.count)

/* The name of a drive's record, such as "2/exposure.factor". */
static const char *record_name(char *name, size_t number, const char *field)
{
    snprintf(name, RECORD_NAME_BYTES + 1, "%zu/%s", number, field);
    return name;
}

static const char *protection_misfit(const ProtectionDesign *p)
{
    if (!p->models)
        return NULL;
    if (!is_within(p->models, 1, MODELS_MAX) || !is_within(p->states, 4, STATES_MAX) ||
        !is_within(p->frames, 1, BLOCK_FRAMES_MAX) || !is_within(p->stride, 1, p->frames) ||
        !is_within(p->watched, 1, p->frames) || (p->watched - 1) * p->stride >= p->frames ||
        !is_within(p->tail_points, 1, TAIL_POINTS_MAX) || !is_within(p->currents, 1, p->models + 1) ||
        !is_within(p->hold_blocks, 1, COUNT_MAX))
        return "protection: a count does not fit";
    if (!(p->level > 0.0) || !(p->resistance_ohm > 0.0) || !(p->hottest_k >= 0.0) ||
        !(p->current_a >= 0.0) || !(p->recovery > 0.0))
        return "protection: a number does not fit";
    return NULL;
}

static const char *exposure_misfit(const ExposureDesign *e)
{
    if (!is_within(e->factor, 1, COUNT_MAX) || !is_within(e->decimation_taps, 1, DECIMATION_TAPS_MAX) ||
        e->motion_taps > MOTION_TAPS_MAX || e->motion.count > SECTIONS_MAX ||
        e->weighting.count > SECTIONS_MAX || e->above.count > SECTIONS_MAX ||
        !is_within(e->reading_frames, 1, COUNT_MAX))
        return "exposure: a count does not fit";
    if (!(e->period_s > 0.0) || (e->cap_a8_m_s2 > 0.0) != (e->cap_vdv > 0.0))
        return "exposure: a number does not fit";
    return NULL;
}

const char *drive_design_read(Records records, size_t number, DriveDesign *d)
{
    char name[RECORD_NAME_BYTES + 1] = {0};
    ProtectionDesign *p = &d->protection;
    ExposureDesign *e = &d->exposure;
    memset(d, 0, sizeof *d);
#define ENTRY(field)                                                                               \
    if (!record_count(records, record_name(name, number, #field), &d->field) ||                    \
        d->field > COUNT_MAX)                                                                      \
        return "a drive lacks the count " #field;
    DRIVE_COUNTS(ENTRY)
#undef ENTRY
#define ENTRY(field)                                                                               \
    if (!record_number(records, record_name(name, number, #field), &d->field) ||                   \
        !isfinite(d->field))                                                                       \
        return "a drive lacks the number " #field;
    DRIVE_NUMBERS(ENTRY)
#undef ENTRY
    if (d->damping.count > SECTIONS_MAX)
        return "damping: a count does not fit";
    if (protection_misfit(p))
        return protection_misfit(p);
    if (p->models && exposure_misfit(e))
        return exposure_misfit(e);
    Table table;
#define ENTRY(field, count)                                                                        \
    if (!record_table(records, record_name(name, number, #field), &table) ||                       \
        table.length != (count) || !table_is_finite(table))                                             \
        return "a drive lacks the table " #field;                                                  \
    d->field = table.at;
    DRIVE_TABLES(ENTRY)
#undef ENTRY
    if (!record_table(records, record_name(name, number, "protection.thermal"), &table) ||
        (table.length != 6 && table.length != 0) || !table_is_finite(table))
        return "a drive lacks the table protection.thermal";
    p->thermal = table.length ? table.at : NULL;
    if (p->thermal && (!(p->coil_k_per_w > 0.0) || !(p->coil_j_per_k > 0.0) || !(p->approach_s > 0.0) ||
                       !(p->thermal[2] > 0.0)))
        return "protection: a number of the thermal model is not above 0";
    return NULL;
}
