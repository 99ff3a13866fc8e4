/* Finds onsets with a short window in every tick; docs/transform.md has the rules. */

#include "onsets.h"
#include "loudness.h"

static size_t edge(const Settings *s, size_t band) { return (size_t)s->band_edges.at[band]; }

size_t onsets_work(const Settings *s, const Fft *fft)
{
    return fft->frames + 3 * s->short_bins + fft_work(fft) + onsets_bands(s);
}

void onsets_reset(const Settings *s, Onsets *onsets)
{
    const size_t bands = onsets_bands(s);
    memset(onsets->peaks, 0, s->short_ticks * sizeof(double));
    memset(onsets->past, 0, s->back_ticks * bands * sizeof(double));
    memset(onsets->highest, 0, bands * sizeof(double));
    memset(onsets->power, 0, s->short_bins * sizeof(double));
    memset(onsets->rising, 0, bands * sizeof(double));
    onsets->since = (double)s->rest_ticks;
    onsets->newest = onsets->peak = 0.0;
}

/* Return an upper bound on |sample| in the onset window, and shift `peaks` by one tick. */
static double loudest_of(const Settings *s, const Onsets *onsets)
{
    const double loudest = maximum(onsets->peaks, s->short_ticks);
    memmove(onsets->peaks, onsets->peaks + 1, (s->short_ticks - 1) * sizeof(double));
    onsets->peaks[s->short_ticks - 1] = 0.0;
    return loudest;
}

SIMD_CLONES static void powers(const double *restrict real, const double *restrict imaginary, double scale,
                        size_t bins, double *restrict power)
{
    for (size_t bin = 0; bin < bins; bin++)
        power[bin] = (real[bin] * real[bin] + imaginary[bin] * imaginary[bin]) * scale;
}

/* Write the powers of bins and bands. All powers are 0 if the square of `loudest` is below `quietest`. */
static void power_of_bands(const Settings *s, const Fft *fft, double loudest, const double *samples,
                double *power, double *bands, double *work)
{
    const size_t count = onsets_bands(s);
    memset(bands, 0, count * sizeof(double));
    if (!(loudest * loudest >= s->quietest)) {
        memset(power, 0, s->short_bins * sizeof(double));
        return;
    }
    double *out = work, *real = out + fft->frames, *imaginary = real + s->short_bins;
    memset(out + s->short_frames, 0, (fft->frames - s->short_frames) * sizeof(double));
    apply_window(samples, s->short_window.at, s->short_frames, out);
    fft_spectrum(fft, out, s->short_bins, real, imaginary, imaginary + s->short_bins);
    powers(real, imaginary, s->short_scale, s->short_bins, power);
    for (size_t band = 0; band < count; band++)
        bands[band] = sum(power + edge(s, band), edge(s, band + 1) - edge(s, band));
}

static double mean_square(const double *samples, size_t count)
{
    double total = 0.0;
    for (size_t one = 0; one < count; one++)
        total += samples[one] * samples[one];
    return total / (double)count;
}

static void remember(const Settings *s, const Onsets *onsets, const double *bands)
{
    const size_t count = onsets_bands(s), older = (s->back_ticks - 1) * count;
    for (size_t band = 0; band < count; band++) {
        const double kept = larger(onsets->highest[band] * s->fading, onsets->past[band]);
        onsets->highest[band] = kept < s->forgotten ? 0.0 : kept;
    }
    memmove(onsets->past, onsets->past + count, older * sizeof(double));
    memcpy(onsets->past + older, bands, count * sizeof(double));
}

/* Set rising[band] to 1 for each band that rises, and to 0 for others; return whether this is an onset. */
static int detect(const Settings *s, const Onsets *onsets, const double *bands, double *rising)
{
    const size_t count = onsets_bands(s);
    const double total = sum(bands, count);
    double risen = 0.0;
    for (size_t band = 0; band < count; band++) {
        const int rose =
            bands[band] > s->rise * onsets->highest[band] && bands[band] > s->minor * total;
        rising[band] = rose;
        risen += rose ? bands[band] : 0.0;
    }
    const size_t back = onsets->since >= (double)s->rearmed_ticks ? 3 : 2;
    const double *before = onsets->past + (s->back_ticks - back) * count;
    const int armed =
        onsets->since >= (double)s->rest_ticks || risen > s->rearmed * sum(before, count);
    return armed && risen > s->quietest && risen > s->risen_share * total;
}

int onsets_detect(const Settings *s, const Fft *fft, Onsets *onsets, const double *samples, double *work)
{
    const size_t count = onsets_bands(s);
    double *power = work, *bands = power + s->short_bins;
    const double peak = onsets->peaks[s->short_ticks - 1];
    power_of_bands(s, fft, loudest_of(s, onsets), samples, power, bands, bands + count);
    remember(s, onsets, bands);
    onsets->since = smaller(onsets->since + 1.0, (double)(s->rest_ticks + s->heard_ticks));
    double *rising = bands + count;
    const int onset = detect(s, onsets, bands, rising);
    if (onset) {
        onsets->since = onsets->newest = onsets->peak = 0.0;
        for (size_t band = 0; band < count; band++)
            onsets->highest[band] = larger(onsets->highest[band], bands[band]);
        memset(onsets->power, 0, s->short_bins * sizeof(double));
        memcpy(onsets->rising, rising, count * sizeof(double));
    }
    if (onsets_are_measured(s, onsets)) {
        const double *tick = samples + (s->short_frames - s->tick_frames);
        const double *half = samples + (s->short_frames - s->newest_frames);
        for (size_t bin = 0; bin < s->short_bins; bin++)
            onsets->power[bin] += power[bin];
        const double newest =
            larger(mean_square(tick, s->tick_frames), mean_square(half, s->newest_frames));
        onsets->newest = larger(newest, onsets->newest);
        onsets->peak = larger(peak, onsets->peak);
    }
    return onset;
}

/* Return the sum of onsets->power over a band's bins, or 0 if the band did not rise. */
static double risen(const Settings *s, const Onsets *onsets, size_t band)
{
    const size_t first = edge(s, band);
    if (onsets->rising[band] == 0.0)
        return 0.0;
    return sum(onsets->power + first, edge(s, band + 1) - first);
}

size_t onsets_groups(const Settings *s, const Onsets *onsets, Group *groups)
{
    const size_t count = onsets_bands(s), most = s->groups_max;
    double powers_kept[FRESH_MAX];
    size_t kept = 0, first = 0;
    double total = 0.0, before = 0.0, here = risen(s, onsets, 0);
    for (size_t band = 0; band < count; band++) {
        const double after = band + 1 < count ? risen(s, onsets, band + 1) : 0.0;
        /* A band at a local minimum of power belongs to the lower group. */
        const int valley = band >= 1 && band + 1 < count && s->apart_from * here < before &&
                           !(s->apart_from * after < here);
        total += here;
        before = here;
        here = after;
        if (!valley && band + 1 < count)
            continue;
        const Group group = {first, band + 1};
        const double power = total;
        first = band + 1;
        total = 0.0;
        if (!(power > 0.0))
            continue;
        /* Keep at most groups_max groups: drop the weakest; of equally weak groups, drop the upper one. */
        if (kept == most) {
            size_t weakest = 0;
            for (size_t one = 1; one < kept; one++)
                if (powers_kept[one] <= powers_kept[weakest])
                    weakest = one;
            if (!(power > powers_kept[weakest]))
                continue;
            for (size_t one = weakest; one + 1 < kept; one++) {
                powers_kept[one] = powers_kept[one + 1];
                groups[one] = groups[one + 1];
            }
            kept--;
        }
        powers_kept[kept] = power;
        groups[kept++] = group;
    }
    return kept;
}

OnsetTone onsets_estimate(const Settings *s, const Onsets *onsets, Group group)
{
    double weighted = 0.0, squares = 0.0, power = 0.0;
    for (size_t band = group.first; band < group.last; band++) {
        if (onsets->rising[band] == 0.0)
            continue;
        /* The lowest band includes all bins below its lower edge. */
        for (size_t bin = band ? edge(s, band) : 0; bin < edge(s, band + 1); bin++) {
            const double one = onsets->power[bin];
            weighted += one * one * s->short_hz.at[bin];
            squares += one * one;
            power += one;
        }
    }
    const double share = smaller(1.0, power / larger(sum(onsets->power, s->short_bins), TINY));
    const size_t told = (size_t)smaller(onsets->since, (double)(s->heard_ticks - 1));
    double purity = smaller(1.0, squares / larger(power * power * s->one_tone.at[told], TINY));
    /* If the strength follows loudness, noise counts as much as a tone of the same power. */
    if (loudness_is_on(s))
        purity = 1.0;
    const double level = onsets_level(onsets), by_power = sqrt(share * purity);
    const double weight = s->energy_mapping ? by_power : share * sqrt(share) * purity;
    const double left = by_power * level < s->weakest ? 0.0 : weight;
    return (OnsetTone){weighted / larger(squares, TINY), left, left * level};
}

double onsets_power(const Settings *s, const Onsets *onsets, Group group)
{
    const size_t count = onsets_bands(s);
    double total = 0.0;
    for (size_t band = group.first; band < group.last; band++) {
        double most = 0.0;
        for (size_t tick = 0; tick < s->back_ticks; tick++)
            most = larger(onsets->past[tick * count + band], most);
        total += most;
    }
    return total;
}
