/* What callers of one emulator use. Numbers are in the units of its state and control; arrays are in C's order. */

/* The state (S,) one super step after `state` (S,) under `control` (C,). */
void step(const float *k, const float *state, const float *control, float *next) {
    NA_ALIGNED float latent[LATENT];
    encode(k, state, latent);
    super_step(k, latent, control, latent, next);
}

/* `states` (T+1, S): `state` (S,), and the ones after each of `steps` super steps under `controls` (T, C). */
void rollout(const float *k, const float *state, const float *controls, long steps, float *states) {
    NA_ALIGNED float latent[LATENT];
    memcpy(states, state, STATE * sizeof(float));
    encode(k, state, latent);
    for (long t = 0; t < steps; t++) super_step(k, latent, controls + t * CONTROL, latent, states + (t + 1) * STATE);
}

/* Whether `state` (S,) lies in the range of the training. */
float covers(const float *k, const float *state) {
    NA_ALIGNED float latent[LATENT];
    float is_covered;
    encode(k, state, latent);
    latent_is_covered(k, latent, &is_covered);
    return is_covered;
}
