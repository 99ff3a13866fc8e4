/* One actuator's share of a vibration. */

#include "actuator.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define DELAY_MAX_S 2.0
#define AUDIBLE_FADE_S 0.04
#define REST_S 0.05
#define SILENT 1e-30
#define ABSURD 1e30
#define HOLD_S 0.06
#define RELEASE_S 0.5

static const ActuatorWishes NONE = {.gain = 1.0, .audible = 1};

Actuator *actuator_open(unsigned long samplerate)
{
    Actuator *actuator = calloc(1, sizeof *actuator);
    if (!actuator)
        return NULL;
    if (!delay_open(&actuator->delay, DELAY_MAX_S, (double)samplerate)) {
        free(actuator);
        return NULL;
    }
    actuator->meter.samplerate = (double)samplerate;
    actuator->page = page_open();
    actuator_reset(actuator);
    return actuator;
}

void actuator_close(Actuator *actuator)
{
    if (!actuator)
        return;
    page_close(actuator->page);
    delay_close(&actuator->delay);
    free(actuator);
}

void actuator_reset(Actuator *actuator)
{
    actuator->fresh = 1;
    actuator->meter.peak = actuator->meter.square = 0.0;
}

static ActuatorWishes wishes_of(const Actuator *actuator, size_t slot)
{
    ActuatorWishes found = NONE;
    if (!actuator->page || slot >= PAGE_ACTUATORS)
        return found;
    ActuatorWishes *wishes = &actuator->page->wishes[slot];
    PAGE_LOAD(wishes->gain, found.gain);
    PAGE_LOAD(wishes->delay_s, found.delay_s);
    PAGE_LOAD(wishes->audible, found.audible);
    PAGE_LOAD(wishes->damped, found.damped);
    if (found.damped) {
        PAGE_LOAD(wishes->damping_gain, found.damping_gain);
        for (size_t number = 0; number < SECTION_NUMBERS; number++)
            PAGE_LOAD(wishes->section[number], found.section[number]);
    }
    return found;
}

/* What exceeds full scale lowers the level at once, and for a while: a gain that stays does not
 * distort as clipping does. The Python engine's protection sees it coming and starts earlier. */
static double within_full_scale(Actuator *actuator, double sample)
{
    const double size = fabs(sample), samplerate = actuator->meter.samplerate;
    if (size >= actuator->loudest) {
        actuator->loudest = size;
        actuator->held = (size_t)(HOLD_S * samplerate);
    } else if (actuator->held) {
        actuator->held--;
    } else if (actuator->loudest > 1.0) {
        actuator->loudest *= 1.0 - 1.0 / (RELEASE_S * samplerate);
    }
    return actuator->loudest > 1.0 ? sample / actuator->loudest : sample;
}

/* The second-order section of device/drive/damping/damper.py, with the same roundings. */
static void damp(Actuator *actuator, const ActuatorWishes *wishes, float *samples, size_t count)
{
    const double *section = wishes->section;
    double *state = actuator->state;
    const size_t period = (size_t)fmax(1.0, rint(REST_S * actuator->meter.samplerate));
    for (size_t at = 0; at < count; at++) {
        double sample = samples[at];
        if (!(fabs(sample) <= ABSURD))
            sample = 0.0;
        sample = 0.0 + wishes->damping_gain * sample;
        const double damped = section[0] * sample + state[0];
        state[0] = section[1] * sample - section[4] * damped + state[1];
        state[1] = section[2] * sample - section[5] * damped;
        samples[at] = (float)within_full_scale(actuator, damped);
        if (--actuator->until_check == 0) {
            actuator->until_check = period;
            if (fabs(state[0]) < SILENT && fabs(state[1]) < SILENT)
                state[0] = state[1] = 0.0;
        }
    }
}

static void begin(Actuator *actuator, const ActuatorWishes *wishes, size_t delay)
{
    delay_reset(&actuator->delay, delay);
    fade_reset(&actuator->gain, wishes->gain);
    fade_reset(&actuator->audible, actuator->page ? 0.0 : 1.0);
    actuator->state[0] = actuator->state[1] = actuator->loudest = 0.0;
    actuator->held = 0;
    actuator->until_check = (size_t)fmax(1.0, rint(REST_S * actuator->meter.samplerate));
    actuator->fresh = 0;
}

void actuator_process(Actuator *actuator, size_t slot, const float *input, float *output,
                      size_t frames)
{
    if (!frames || !output)
        return;
    const double samplerate = actuator->meter.samplerate;
    const ActuatorWishes wishes = wishes_of(actuator, slot);
    const double delay_s = wishes.delay_s >= 0.0 ? fmin(wishes.delay_s, DELAY_MAX_S) : 0.0;
    const size_t delay = (size_t)(delay_s * samplerate + 0.5);
    if (actuator->fresh)
        begin(actuator, &wishes, delay);
    if (!input)
        memset(output, 0, frames * sizeof(float));
    else if (input != output)
        memmove(output, input, frames * sizeof(float));
    if (wishes.damped)
        damp(actuator, &wishes, output, frames);
    fade_to(&actuator->gain, fabs(wishes.gain) <= 1.0 ? wishes.gain : 0.0, frames);
    fade_to(&actuator->audible, wishes.audible ? 1.0 : 0.0, (size_t)(AUDIBLE_FADE_S * samplerate));
    fade_apply(&actuator->gain, output, frames);
    delay_process(&actuator->delay, output, frames, delay);
    fade_apply_smoothly(&actuator->audible, output, frames);
    level_add(&actuator->meter, output, frames, 1);
    actuator->frames += frames;
    if (actuator->page && slot < PAGE_ACTUATORS) {
        ActuatorReadings *readings = &actuator->page->actuators[slot];
        PAGE_STORE(readings->frames, actuator->frames);
        PAGE_STORE(readings->peak, actuator->meter.peak);
        PAGE_STORE(readings->square, actuator->meter.square);
        PAGE_STORE(readings->audible, actuator->audible.now);
    }
}
