/* The pendulum's super step by hand: sines and cosines of twelve angles, two layers of gated units. STATE, CONTROL,
   ANGLES, HALF0 and HALF1 are defined before; weights come in the order of `enum weights`, columns padded with zeros. */
enum weights { W_ANGLES, W_LOW, W_HIGH, W_MEAN, W_SCALE, W_ODD0, W_EVEN0, W_BIAS0, W_ODD1, W_EVEN1, W_BIAS1, W_OUT,
               W_CHANGE_MEAN, W_CHANGE_SCALE, W_KEPT_LOW, W_KEPT_HIGH };
enum { SHOWN = 3, RAW = SHOWN + CONTROL, FIRST_SHOWN = 3 };

/* Sines and cosines to float32's accuracy: angles within half a turn, then Taylor's series. */
static void sines_cosines(const float *angles, float *sines, float *cosines) {
    for (int i = 0; i < PADDED(ANGLES); i++) {
        const float round = 12582912.0f; /* 1.5 * 2^23: what is added to it is rounded to a whole number */
        const float turns = (angles[i] * 0.318309886f + round) - round;
        const float rest = (angles[i] - turns * 3.140625f) - turns * 9.67653589793e-4f;
        const float halves = (turns * 0.5f + round) - round;
        const float odd = turns - 2.0f * halves;
        const float sign = 1.0f - 2.0f * odd * odd;
        const float s = rest * rest;
        float sine = 1.6059044e-10f;
        sine = sine * s - 2.5052108e-8f;
        sine = sine * s + 2.7557319e-6f;
        sine = sine * s - 1.9841270e-4f;
        sine = sine * s + 8.3333333e-3f;
        sine = sine * s - 1.6666667e-1f;
        sine = sine * s + 1.0f;
        float cosine = -1.1470746e-11f;
        cosine = cosine * s + 2.0876757e-9f;
        cosine = cosine * s - 2.7557319e-7f;
        cosine = cosine * s + 2.4801587e-5f;
        cosine = cosine * s - 1.3888889e-3f;
        cosine = cosine * s + 4.1666667e-2f;
        cosine = cosine * s - 0.5f;
        cosine = cosine * s + 1.0f;
        sines[i] = sign * rest * sine;
        cosines[i] = sign * cosine;
    }
}

static void super_step(const float *const *w, const float *state, const float *control, float *next) {
    float angles[PADDED(ANGLES)] = {0}, odd[PADDED(ANGLES) + PADDED(RAW)], even[PADDED(ANGLES)];
    multiply_add(state, STATE, w[W_ANGLES], ANGLES, angles);
    sines_cosines(angles, odd, even);
    for (int i = 0; i < RAW; i++) {
        const float raw = i < SHOWN ? state[FIRST_SHOWN + i] : control[i - SHOWN];
        odd[ANGLES + i] = (between(w[W_LOW][i], raw, w[W_HIGH][i]) - w[W_MEAN][i]) * w[W_SCALE][i];
    }
    float sums[PADDED(3 * HALF0)] = {0}, levels[PADDED(2 * HALF0)], odd0[HALF0], even0[HALF0];
    memcpy(levels, w[W_BIAS0], sizeof levels);
    multiply_add(odd, ANGLES + RAW, w[W_ODD0], 3 * HALF0, sums);
    multiply_add(even, ANGLES, w[W_EVEN0], 2 * HALF0, levels);
    gate(HALF0, sums, levels, odd0, even0);
    float sums1[PADDED(3 * HALF1)] = {0}, levels1[PADDED(2 * HALF1)], odd1[HALF1], even1[HALF1];
    memcpy(levels1, w[W_BIAS1], sizeof levels1);
    multiply_add(odd0, HALF0, w[W_ODD1], 3 * HALF1, sums1);
    multiply_add(even0, HALF0, w[W_EVEN1], 2 * HALF1, levels1);
    gate(HALF1, sums1, levels1, odd1, even1);
    float change[PADDED(STATE)] = {0};
    multiply_add(odd1, HALF1, w[W_OUT], STATE, change);
    for (int i = 0; i < STATE; i++) next[i] = state[i] + w[W_CHANGE_MEAN][i] + w[W_CHANGE_SCALE][i] * change[i];
    for (int i = 0; i < SHOWN; i++)
        next[FIRST_SHOWN + i] = between(w[W_KEPT_LOW][i], next[FIRST_SHOWN + i], w[W_KEPT_HIGH][i]);
}

/* `states` (T, S): the ones after each of `steps` super steps from `start` under `controls` (T, C). */
void rollout(const float *const *w, const float *start, const float *controls, long steps, float *states) {
    const float *state = start;
    for (long t = 0; t < steps; t++) {
        super_step(w, state, controls + t * CONTROL, states + t * STATE);
        state = states + t * STATE;
    }
}
