/* Finds the principal frequencies of one window. A spectrum may contain any numbers, even NaN: integer
 * limits end all loops, and every computed number is checked before it becomes an index. */

#include "analysis.h"
#include "exact.h"

/* Number of bins with amplitude 0 on each side of the spectrum. The half-power search may read these bins. */
#define EDGE 3

/* In the ranking, r is reduced by this share per bin, so that the lowest of peaks with equal r ranks first. */
#define LOWER_FIRST 1e-10

typedef struct {
    double *edges; /* amplitudes, with EDGE zeros on each side */
    int32_t *turns;
    double *ranks, *sorted;
    Peaks peaks;
    int32_t *chosen; /* indices of the chosen peaks, ascending */
} Work;

/* Lay out the work space in `memory`, or only count its bytes if `memory` is NULL. Return the number of
 * bytes. */
static size_t layout_work(void *memory, size_t bins, Work *work)
{
    const size_t most = bins / 2 + 1;
    Peaks *peaks = &work->peaks;
    double **numbers[] = {&peaks->before, &peaks->top, &peaks->after,        &peaks->offset, &peaks->height,
                          &peaks->level,  &peaks->r,   &peaks->bandwidth_hz, &work->ranks,   &work->sorted};
    int32_t **places[] = {&peaks->left, &peaks->bin, &peaks->right, &work->chosen};
    Arena arena = {memory, 0};
    work->edges = arena_doubles(&arena, bins + 2 * EDGE);
    arena_arrays(&arena, ARRAYS(peaks->down), most);
    arena_arrays(&arena, ARRAYS(peaks->up), most);
    for (size_t which = 0; which < sizeof numbers / sizeof *numbers; which++)
        *numbers[which] = arena_doubles(&arena, most);
    for (size_t which = 0; which < sizeof places / sizeof *places; which++)
        *places[which] = arena_alloc(&arena, most, sizeof(int32_t));
    work->turns = arena_alloc(&arena, bins + 1, sizeof(int32_t));
    return arena.used;
}

size_t analysis_work(size_t bins)
{
    Work work;
    return layout_work(NULL, bins, &work);
}

/* Find the two adjacent bins that bracket half power between a peak and the minimum beside it. From peak to
 * minimum, amplitudes do not rise, except by rounding errors. If the minimum is not below half power, both
 * bins are the minimum. */
INLINED void step_under(const double *amplitude, const Peaks *peaks, int32_t one, int32_t valley,
                        int32_t direction, Side side)
{
    const double *peak = amplitude + peaks->bin[one];
    const double level = peaks->level[one];
    const int32_t length = direction * (valley - peaks->bin[one]);
    int32_t inside = 0;
    for (int32_t ahead = 1; ahead <= EDGE; ahead++)
        inside += (ahead <= length) & !(peak[direction * ahead] < level);
    if (inside == EDGE)
        while (inside < length && !(peak[direction * (inside + 1)] < level))
            inside++;
    const int32_t outside = inside + (inside < length);
    side.near[one] = (double)(direction * inside) - peaks->offset[one];
    side.far[one] = (double)(direction * outside) - peaks->offset[one];
    side.above[one] = larger(peak[direction * inside], level);
    side.under[one] = larger(smaller(peak[direction * outside], level), FLOOR * level);
}

static void find_steps(const double *amplitude, Peaks *peaks)
{
    for (int32_t one = 0; one < peaks->count; one++) {
        step_under(amplitude, peaks, one, peaks->left[one], -1, peaks->down);
        step_under(amplitude, peaks, one, peaks->right[one], 1, peaks->up);
    }
}

/* Return the distance from a peak to half power, in bins. Interpolate ln A linearly in the squared distance,
 * as in a Gaussian curve. A tone's bandwidth then hardly depends on its position between two bins. */
INLINED double side_on_bell(Side side, int32_t one, double level)
{
    const double near = side.near[one] * side.near[one], far = side.far[one] * side.far[one];
    const double above = log_of_normal(side.above[one] / level);
    const double under = log_of_normal(side.under[one] / level);
    return sqrt(near + above / larger(above - under, TINY) * (far - near));
}

SIMD_CLONES static void measure_peaks(const Settings *s, Peaks *peaks)
{
    const Side down = peaks->down, up = peaks->up;
    const double *restrict level = peaks->level, *restrict height = peaks->height;
    double *restrict bandwidth_hz = peaks->bandwidth_hz, *restrict all_r = peaks->r;
    NO_ALIAS
    for (int32_t one = 0; one < peaks->count; one++) {
        const double bins = side_on_bell(down, one, level[one]) + side_on_bell(up, one, level[one]);
        bandwidth_hz[one] = bins * s->bin_hz;
        all_r[one] = height[one] * bandwidth_hz[one];
    }
}

/* Return the n-th largest number, n <= count. sorted: receives the n largest numbers. */
static double nth_largest(const double *numbers, int32_t count, int32_t n, double *sorted)
{
    int32_t filled = 0;
    for (int32_t one = 0; one < count; one++) {
        const double number = numbers[one];
        if (filled == n && !(number > sorted[n - 1]))
            continue;
        int32_t place = filled < n ? filled++ : n - 1;
        for (; place > 0 && number > sorted[place - 1]; place--)
            sorted[place] = sorted[place - 1];
        sorted[place] = number;
    }
    return sorted[n - 1];
}

/* Choose the peaks with r above threshold_hz that exceed the side lobes of the highest such peak. Of more
 * than partials_max such peaks, keep those with the largest r. Write the indices of the chosen peaks to
 * `place`, which has room for all peaks; return their number. */
static int32_t choose(const Settings *s, const Peaks *peaks, int32_t *place, double *ranks, double *sorted)
{
    const int32_t most = (int32_t)s->partials_max;
    double highest = 0.0;
    for (int32_t one = 0; one < peaks->count; one++)
        if (peaks->r[one] > s->threshold_hz)
            highest = larger(peaks->height[one], highest);
    int32_t count = 0;
    for (int32_t one = 0; one < peaks->count; one++) {
        const double r = peaks->r[one];
        place[count] = one;
        ranks[count] = r - r * (LOWER_FIRST * (double)peaks->bin[one]);
        count += (r > s->threshold_hz) & (peaks->height[one] > s->side_lobe * highest);
    }
    if (count <= most)
        return count;
    const double least = nth_largest(ranks, count, most, sorted);
    int32_t equals = 0, kept = 0;
    while (equals < most && sorted[most - 1 - equals] == least)
        equals++;
    for (int32_t one = 0; one < count; one++)
        if (ranks[one] > least || (ranks[one] == least && equals-- > 0))
            place[kept++] = place[one];
    return kept;
}

int32_t find_principal(const Settings *s, Spectrum spectrum, Principals found, void *memory)
{
    const int32_t bins = (int32_t)s->bins;
    Work work;
    layout_work(memory, s->bins, &work);
    double *amplitude = work.edges + EDGE;
    for (int32_t edge = 1; edge <= EDGE; edge++)
        amplitude[-edge] = amplitude[bins - 1 + edge] = 0.0;
    Peaks *peaks = &work.peaks;
    peaks_amplitudes(spectrum, amplitude, bins);
    peaks_clear_images(s, spectrum, amplitude, peaks);
    peaks_list(s, amplitude, work.turns, peaks);
    peaks_refine(amplitude, peaks);
    find_steps(amplitude, peaks);
    measure_peaks(s, peaks);
    const int32_t count = choose(s, peaks, work.chosen, work.ranks, work.sorted);
    for (int32_t one = 0; one < count; one++) {
        const int32_t place = work.chosen[one];
        found.audio_hz[one] = ((double)peaks->bin[place] + peaks->offset[place]) * s->bin_hz;
        found.amplitude[one] = peaks->height[place];
        found.bandwidth_hz[one] = peaks->bandwidth_hz[place];
        found.r[one] = peaks->r[place];
    }
    return count;
}
