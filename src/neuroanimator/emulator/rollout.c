/* Functions for callers of an emulator. Numbers are in the units of its state and control; arrays are in C order. */

/* The state (S,) one super step after `state` (S,) under `control` (C,); returns whether both states
   are small enough and the control is finite. */
int step(const float *k, const float *state, const float *control, float *next) {
    NA_ALIGNED float latent[LATENT];
    encode(k, state, latent);
    super_step(k, latent, control, latent, next);
    const int is_given_sound = all_below(state, STATE, MAX_MAGNITUDE) & all_finite(control, CONTROL);
    return is_given_sound & all_below(next, STATE, MAX_MAGNITUDE);
}

/* `states` (T+1, S): `state` (S,), and the states after each of `steps` super steps under `controls` (T, C). Returns
   whether all states are small enough and all else is finite. */
int rollout(const float *k, const float *state, const float *controls, long steps, float *states) {
    NA_ALIGNED float latent[LATENT];
    memcpy(states, state, STATE * sizeof(float));
    encode(k, state, latent);
    for (long t = 0; t < steps; t++) super_step(k, latent, controls + t * CONTROL, latent, states + (t + 1) * STATE);
    const int is_given_sound = all_below(state, STATE, MAX_MAGNITUDE) & all_finite(controls, steps * CONTROL);
    return is_given_sound & all_below(states, (steps + 1) * STATE, MAX_MAGNITUDE);
}

/* `rollout`, and `scores` (T,): the distance of each step's state and control from training. */
int rollout_trusted(
    const float *k, const float *state, const float *controls, long steps, float *states, float *scores
) {
    NA_ALIGNED float latent[LATENT];
    memcpy(states, state, STATE * sizeof(float));
    encode(k, state, latent);
    for (long t = 0; t < steps; t++)
        super_step_trusted(k, latent, controls + t * CONTROL, latent, states + (t + 1) * STATE, scores + t);
    const int is_given_sound = all_below(state, STATE, MAX_MAGNITUDE) & all_finite(controls, steps * CONTROL);
    return is_given_sound & all_below(states, (steps + 1) * STATE, MAX_MAGNITUDE);
}

/* Distance of `state` (S,) under `control` (C,) from training: 1 is the edge. */
float trust(const float *k, const float *state, const float *control) {
    NA_ALIGNED float latent[LATENT], next[STATE];
    float score;
    encode(k, state, latent);
    super_step_trusted(k, latent, control, latent, next, &score);
    return score;
}
