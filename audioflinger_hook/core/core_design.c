/* Parses a design. core/design.py writes designs; device/drive/design.py computes the drives in them. */

#include "core_parts.h"

#define HIGHEST_RATE 768000
#define DELAY_MAX_S 10.0
#define COUNT_MAX 65536

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
    ENTRY(exposure.volts_per_full_scale) ENTRY(exposure.period_s) ENTRY(exposure.running_share)     \
    ENTRY(exposure.cap_a8_m_s2) ENTRY(exposure.cap_vdv)

/* Tables and their lengths. d: the drive; p: its protection; e: its exposure. */
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

/* Write the name of a field's record in drive `number`, such as "2/exposure.factor"; return the name. */
static const char *record_name(char *name, size_t number, const char *field)
{
    const size_t tens = number > 9; /* number < 100 */
    name[0] = (char)('0' + number / 10);
    name[tens] = (char)('0' + number % 10);
    name[tens + 1] = '/';
    strcpy(name + tens + 2, field);
    return name;
}

static const char *protection_misfit(const ProtectionDesign *p)
{
    if (!p->models)
        return NULL;
    REQUIRE(is_within(p->models, 1, MODELS_MAX) && is_within(p->states, 4, STATES_MAX) &&
                is_within(p->frames, 1, BLOCK_FRAMES_MAX) && is_within(p->stride, 1, p->frames) &&
                is_within(p->watched, 1, p->frames) && (p->watched - 1) * p->stride < p->frames &&
                is_within(p->tail_points, 1, TAIL_POINTS_MAX) && is_within(p->currents, 1, p->models + 1) &&
                is_within(p->hold_blocks, 1, COUNT_MAX),
            "protection: a count does not fit");
    REQUIRE(p->level > 0.0 && p->resistance_ohm > 0.0 && p->hottest_k >= 0.0 && p->current_a >= 0.0 &&
                p->recovery > 0.0,
            "protection: a number does not fit");
    return NULL;
}

static const char *exposure_misfit(const ExposureDesign *e)
{
    REQUIRE(is_within(e->factor, 1, COUNT_MAX) && is_within(e->decimation_taps, 1, DECIMATION_TAPS_MAX) &&
                e->motion_taps <= MOTION_TAPS_MAX && e->motion.count <= SECTIONS_MAX &&
                e->weighting.count <= SECTIONS_MAX && e->above.count <= SECTIONS_MAX &&
                is_within(e->reading_frames, 1, COUNT_MAX),
            "exposure: a count does not fit");
    REQUIRE(e->period_s > 0.0 && (e->cap_a8_m_s2 > 0.0) == (e->cap_vdv > 0.0),
            "exposure: a number does not fit");
    return NULL;
}

/* Parse a drive; check its counts, numbers and table lengths. Return NULL or an error message. */
static const char *drive_design_read(Records records, size_t number, DriveDesign *d)
{
    char name[RECORD_NAME_BYTES + 1] = {0};
    ProtectionDesign *p = &d->protection;
    ExposureDesign *e = &d->exposure;
    memset(d, 0, sizeof *d);
#define ENTRY(field)                                                                               \
    REQUIRE(record_count(records, record_name(name, number, #field), &d->field) &&                 \
                d->field <= COUNT_MAX, "a drive lacks the count " #field);
    DRIVE_COUNTS(ENTRY)
#undef ENTRY
#define ENTRY(field)                                                                               \
    REQUIRE(record_number(records, record_name(name, number, #field), &d->field) &&                \
                isfinite(d->field), "a drive lacks the number " #field);
    DRIVE_NUMBERS(ENTRY)
#undef ENTRY
    REQUIRE(d->damping.count <= SECTIONS_MAX, "damping: a count does not fit");
    const char *misfit = protection_misfit(p);
    if (!misfit && p->models)
        misfit = exposure_misfit(e);
    if (misfit)
        return misfit;
    Table table;
#define ENTRY(field, count)                                                                        \
    REQUIRE(record_table(records, record_name(name, number, #field), &table) &&                    \
                table.length == (count) && table_is_finite(table), "a drive lacks the table " #field); \
    d->field = table.at;
    DRIVE_TABLES(ENTRY)
#undef ENTRY
    REQUIRE(record_table(records, record_name(name, number, "protection.thermal"), &table) &&
                (table.length == 6 || table.length == 0) && table_is_finite(table),
            "a drive lacks the table protection.thermal");
    p->thermal = table.length ? table.at : NULL;
    REQUIRE(!p->thermal || (p->coil_k_per_w > 0.0 && p->coil_j_per_k > 0.0 && p->approach_s > 0.0 &&
                            p->thermal[2] > 0.0),
            "protection: a number of the thermal model is not above 0");
    return NULL;
}

/* Return the count in a record, or 0 if the record is missing. */
static size_t count_or_none(Records records, const char *name)
{
    size_t count;
    return record_count(records, name, &count) ? count : 0;
}

static const char *read_sources(CoreDesign *design, Records records)
{
    const size_t sources = count_or_none(records, "sources");
    Table weights;
    if (!sources)
        return NULL;
    REQUIRE(design->has_transform && sources <= CORE_CHANNELS &&
                record_table(records, "source_weights", &weights) &&
                weights.length == 2 * sources * design->info.inputs,
            "sources: their weights do not fit");
    design->weights = weights.at;
    design->info.vibrations = (uint32_t)sources;
    return NULL;
}

static const char *read_drives(CoreDesign *design, DriveDesign *drives, Records records)
{
    const size_t actuators = count_or_none(records, "actuators");
    design->drives = count_or_none(records, "drives");
    Table numbers;
    if (!actuators)
        return NULL;
    const size_t delay = count_or_none(records, "delay_frames_max");
    REQUIRE(actuators <= CORE_ACTUATORS && design->drives <= DRIVES_MAX &&
                (double)delay <= DELAY_MAX_S * (double)design->info.samplerate &&
                record_table(records, "drive_of_actuator", &numbers) && numbers.length == actuators,
            "actuators: a count does not fit");
    design->info.actuators = (uint32_t)actuators;
    design->info.delay_frames_max = (uint32_t)delay;
    for (size_t number = 0; number < design->drives; number++) {
        DriveDesign one, *drive = drives ? drives + number : &one;
        const char *misfit = drive_design_read(records, number, drive);
        if (misfit)
            return misfit;
        const size_t latency = drive_latency_frames(drive);
        if (latency > design->info.drive_latency_frames)
            design->info.drive_latency_frames = (uint32_t)latency;
    }
    for (size_t actuator = 0; actuator < actuators; actuator++) {
        const double number = numbers.at[actuator];
        const int is_drive = number >= 0.0 && number < (double)design->drives;
        REQUIRE(is_drive || number == -1.0, "actuators: there is no such drive");
        design->drive_of[actuator] = is_drive ? (size_t)number : DRIVES_MAX;
    }
    return NULL;
}

const char *core_design_read(CoreDesign *design, DriveDesign *drives, const void *bytes, size_t size)
{
    Records records;
    size_t samplerate, inputs;
    memset(design, 0, sizeof *design);
    const char *misfit = records_open(&records, (void *)(uintptr_t)bytes, size);
    if (misfit)
        return misfit;
    REQUIRE(record_count(records, "samplerate", &samplerate) && is_within(samplerate, 1, HIGHEST_RATE) &&
                record_count(records, "inputs", &inputs) && is_within(inputs, 1, CORE_ACTUATORS),
            "it lacks samplerate or inputs");
    design->info.samplerate = (uint32_t)samplerate;
    design->info.inputs = design->info.vibrations = (uint32_t)inputs;
    design->per_channel = count_or_none(records, "per_channel") != 0;
    design->has_transform = count_or_none(records, "window_frames") != 0;
    if (design->has_transform) {
        size_t latency, tonal_latency;
        REQUIRE(record_count(records, "latency_frames", &latency) &&
                    record_count(records, "tonal_latency_frames", &tonal_latency),
                "it lacks latency_frames or tonal_latency_frames");
        misfit = settings_read(&design->settings, records);
        if (misfit)
            return misfit;
        design->info.latency_frames = (uint32_t)latency;
        design->info.tonal_latency_frames = (uint32_t)tonal_latency;
        if (!design->per_channel)
            design->info.vibrations = 1;
    }
    misfit = read_sources(design, records);
    return misfit ? misfit : read_drives(design, drives, records);
}
