/* FFT plans: factorisation and twiddle factors. */

#include "exact.h"
#include "fft.h"

/* Write cosine and sine of 2 pi part / whole. Both are exact if the angle is a multiple of pi/2. */
static void turn_of(size_t part, size_t whole, double *cosine, double *sine)
{
    const size_t eighths = 8 * (part % whole);
    const size_t octant = eighths / whole;
    /* Split the angle into the nearest multiple of pi/2 and a rest between -pi/4 and pi/4. */
    const size_t quarter = (octant + 1) / 2;
    const double rest = ((double)eighths - 2.0 * (double)quarter * (double)whole) / (double)whole;
    const double c = exact_cos(PI / 4 * rest), s = exact_sin(PI / 4 * rest);
    switch (quarter % 4) {
    case 0: *cosine = c, *sine = s; break;
    case 1: *cosine = -s, *sine = c; break;
    case 2: *cosine = -c, *sine = -s; break;
    default: *cosine = s, *sine = -c; break;
    }
}

/* Write cosine and sine of 2 pi k step / whole for k < count; return the address after the last sine. */
static double *write_turns(double *table, size_t count, size_t step, size_t whole)
{
    for (size_t one = 0; one < count; one++, table += 2)
        turn_of(one * step, whole, table, table + 1);
    return table;
}

/* Factorise `size` into 5, 3, 4 and 2; return whether no other factor remains. */
static int factorise(FftStages *stages, size_t size)
{
    static const size_t PRIMES[] = {5, 3, 4, 2};
    stages->size = size;
    stages->count = 0;
    for (size_t which = 0; which < sizeof PRIMES / sizeof *PRIMES; which++)
        for (; size % PRIMES[which] == 0; size /= PRIMES[which])
            stages->factors[stages->count++] = PRIMES[which];
    return size == 1;
}

static double *write_passes(FftStages *stages, double *table)
{
    stages->twiddles = table;
    size_t size = stages->size;
    for (size_t which = 0; which < stages->count; which++) {
        const size_t factor = stages->factors[which], rest = size / factor;
        for (size_t place = 0; place < rest; place++)
            for (size_t output = 1; output < factor; output++, table += 2)
                turn_of(place * output, size, table, table + 1);
        size = rest;
    }
    return table;
}

/* Arrange all points in the grid closest to a square; return 0 if their number has a prime factor above 5. */
static int make_grid(Fft *fft)
{
    FftStages all;
    if (!factorise(&all, fft->points))
        return 0;
    size_t best = 1;
    for (size_t columns = 1; columns <= fft->points; columns++)
        if (fft->points % columns == 0 && columns * columns <= fft->points)
            best = columns;
    factorise(&fft->columns, fft->points / best);
    factorise(&fft->rows, best);
    fft->columns.run = best * fft->lanes;
    fft->rows.run = fft->points / best * fft->lanes;
    return 1;
}

int fft_open(Fft *fft, size_t length, int padded, Arena *arena)
{
    memset(fft, 0, sizeof *fft);
    fft->length = length;
    fft->halved = length % 2 == 0 ? length / 2 : 0;
    fft->lanes = padded && length % 4 == 0 ? 2 : 1;
    fft->points = fft->halved ? fft->halved / fft->lanes : length;
    fft->frames = fft->lanes == 2 ? length / 2 : length;
    if (length == 0 || !make_grid(fft))
        return 0;
    const size_t lane_turns = fft->lanes == 2 ? 2 * fft->points : 0;
    const size_t bins = fft->halved ? fft->halved + 1 : 0;
    /* The table of an FFT of `size` numbers has size - 1 twiddle factors. */
    const size_t twiddles = 2 * (fft->columns.size + fft->rows.size - 2);
    const size_t total = twiddles + lane_turns + 2 * fft->points + 2 * bins;
    double *table = arena_alloc(arena, total, sizeof(double));
    if (!table)
        return 1;
    table = write_passes(&fft->columns, table);
    table = write_passes(&fft->rows, table);
    fft->lane_turn = table;
    table = write_turns(table, lane_turns / 2, 1, fft->halved ? fft->halved : 1);
    fft->grid_turn = table;
    for (size_t column = 0; column < fft->rows.size; column++)
        table = write_turns(table, fft->columns.size, column, fft->points);
    fft->bin_cos = table;
    fft->bin_sin = table + bins;
    for (size_t bin = 0; bin < bins; bin++)
        turn_of(bin, length, table + bin, table + bins + bin);
    return 1;
}

