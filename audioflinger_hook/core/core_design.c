/* Reads all that a core is made for; core/design.py writes it. */

#include "core_parts.h"

#define HIGHEST_RATE 768000
#define DELAY_MAX_S 10.0

/* The count of a record, 0 if there is none. */
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
    if (!design->has_transform || sources > CORE_CHANNELS ||
        !record_table(records, "source_weights", &weights) ||
        weights.length != 2 * sources * design->info.inputs)
        return "sources: their weights do not fit";
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
    if (actuators > CORE_ACTUATORS || design->drives > DRIVES_MAX ||
        (double)delay > DELAY_MAX_S * (double)design->info.samplerate ||
        !record_table(records, "drive_of_actuator", &numbers) || numbers.length != actuators)
        return "actuators: a count does not fit";
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
        if (!is_drive && number != -1.0)
            return "actuators: there is no such drive";
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
    if (!record_count(records, "samplerate", &samplerate) || !is_within(samplerate, 1, HIGHEST_RATE) ||
        !record_count(records, "inputs", &inputs) || !is_within(inputs, 1, CORE_ACTUATORS))
        return "it lacks samplerate or inputs";
    design->info.samplerate = (uint32_t)samplerate;
    design->info.inputs = design->info.vibrations = (uint32_t)inputs;
    design->per_channel = count_or_none(records, "per_channel") != 0;
    design->has_transform = count_or_none(records, "window_frames") != 0;
    if (design->has_transform) {
        size_t latency, tonal_latency;
        if (!record_count(records, "latency_frames", &latency) ||
            !record_count(records, "tonal_latency_frames", &tonal_latency))
            return "it lacks latency_frames or tonal_latency_frames";
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
