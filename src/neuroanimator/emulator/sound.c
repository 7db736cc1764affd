/* Whether numbers are what an emulator accepts, without a branch: so that looking at them fills registers. */

/* Whether the magnitude of each of `count` numbers is below `limit`; none that is not a number is. */
static int all_below(const float *numbers, long count, float limit) {
    int has_other = 0;
    for (long i = 0; i < count; i++) has_other |= !(fabsf(numbers[i]) < limit);
    return !has_other;
}

static int all_finite(const float *numbers, long count) { return all_below(numbers, count, INFINITY); }
