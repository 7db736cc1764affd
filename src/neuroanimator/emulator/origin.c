/* States as callers have them, floats or doubles, and as super steps need them: relative to an origin, in floats. */

/* Whether the magnitude of each of `count` numbers is below `limit`; that of NaN is not. Without branches, to vectorise. */
static int all_below(const float *numbers, long count, float limit) {
    int has_other = 0;
    for (long i = 0; i < count; i++) has_other |= !(fabsf(numbers[i]) < limit);
    return !has_other;
}

static int all_finite(const float *numbers, long count) { return all_below(numbers, count, INFINITY); }

/* `way` rounded as GRID says. */
static double on_grid(double way) { return (way + GRID) - GRID; }

/* The number at `index` of `numbers`, doubles or floats. */
static double number_of(const void *numbers, long index, int is_double) {
    return is_double ? ((const double *)numbers)[index] : ((const float *)numbers)[index];
}

/* `size` bytes of a state of doubles or floats. */
static size_t bytes_of(long count, int is_double) { return count * (is_double ? sizeof(double) : sizeof(float)); }

/* The `origin` (AXES,) of `state` (S,), and the state `relative` to it. Returns whether its numbers are small enough. */
static int take_apart(const void *state, int is_double, double *origin, float *relative) {
    int has_other = 0;
    for (int i = 0; i < STATE; i++) {
        const double number = number_of(state, i, is_double);
        has_other |= !(fabs(number) < MAX_MAGNITUDE);
        relative[i] = (float)number;
    }
    for (int a = 0; a < AXES; a++) origin[a] = number_of(state, state_first[a], is_double);
    for (int p = 0; p < MOVED_STATE; p++)
        relative[state_entry[p]] = (float)(number_of(state, state_entry[p], is_double) - origin[state_axis[p]]);
    return !has_other;
}

/* Writes the state `relative` to `origin` to row `row` of `states`, with the parameters of `start`, which nothing changes.
   Returns whether its numbers are small enough. */
static int put_together(
    const double *origin, const float *relative, const void *start, int is_double, void *states, long row
) {
    const int moving = STATE - PARAMETERS;
    int has_other = 0;
    if (is_double) {
        double *state = (double *)states + row * STATE;
        for (int i = 0; i < STATE; i++) state[i] = relative[i];
        for (int p = 0; p < MOVED_STATE; p++)
            state[state_entry[p]] = origin[state_axis[p]] + on_grid(relative[state_entry[p]]);
        memmove(state + moving, (const double *)start + moving, PARAMETERS * sizeof(double));
        for (int i = 0; i < STATE; i++) has_other |= !(fabs(state[i]) < MAX_MAGNITUDE);
    } else {
        float *state = (float *)states + row * STATE;
        memcpy(state, relative, STATE * sizeof(float));
        for (int p = 0; p < MOVED_STATE; p++)
            state[state_entry[p]] = (float)(origin[state_axis[p]] + on_grid(relative[state_entry[p]]));
        memmove(state + moving, (const float *)start + moving, PARAMETERS * sizeof(float));
        has_other = !all_below(state, STATE, (float)MAX_MAGNITUDE);
    }
    return !has_other;
}

/* Moves `origin` to the first number along each axis of a latent state, whose entries are `stride` apart. */
static void move_origin(double *origin, float *latent, int stride) {
    float way[AXES + 1];
    for (int a = 0; a < AXES; a++) {
        way[a] = latent[latent_first[a] * stride];
        origin[a] += on_grid(way[a]);
    }
    for (int p = 0; p < MOVED_LATENT; p++) latent[latent_entry[p] * stride] -= way[latent_axis[p]];
}
