/* A delay of samples, changed without a click. */

#include "delay_line.h"

#include <stdlib.h>
#include <string.h>

#define FADE_S 0.02

int delay_open(DelayLine *line, double longest_s, double samplerate)
{
    memset(line, 0, sizeof *line);
    const double frames = longest_s * samplerate + 1.0;
    for (line->capacity = 1; (double)line->capacity < frames;)
        line->capacity *= 2;
    line->fade_frames = (size_t)(FADE_S * samplerate) + 1;
    line->past = calloc(line->capacity, sizeof(float));
    return line->past != NULL;
}

void delay_close(DelayLine *line)
{
    free(line->past);
    line->past = NULL;
}

void delay_reset(DelayLine *line, size_t frames)
{
    memset(line->past, 0, line->capacity * sizeof(float));
    line->next = line->fading = 0;
    line->delay = line->before = frames < line->capacity ? frames : line->capacity - 1;
}

void delay_process(DelayLine *line, float *samples, size_t count, size_t frames)
{
    const size_t mask = line->capacity - 1;
    frames = frames < mask ? frames : mask;
    for (size_t at = 0; at < count; at++) {
        if (frames != line->delay && !line->fading) {
            line->before = line->delay;
            line->delay = frames;
            line->fading = line->fade_frames;
        }
        line->past[line->next] = samples[at];
        float sample = line->past[(line->next - line->delay) & mask];
        if (line->fading) {
            const float share = (float)line->fading-- / (float)line->fade_frames;
            sample += share * (line->past[(line->next - line->before) & mask] - sample);
        }
        samples[at] = sample;
        line->next = (line->next + 1) & mask;
    }
}
