/* Whether an emulator accepts numbers, without branches, so that the checks vectorise. */

/* Whether the magnitude of each of `count` numbers is below `limit`; that of NaN is not. */
static int all_below(const float *numbers, long count, float limit) {
    int has_other = 0;
    for (long i = 0; i < count; i++) has_other |= !(fabsf(numbers[i]) < limit);
    return !has_other;
}

static int all_finite(const float *numbers, long count) { return all_below(numbers, count, INFINITY); }
