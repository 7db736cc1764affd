/* Functions for callers of an emulator. Numbers are in the units of its state and control; arrays are in C order. States are
   doubles if `is_double`, otherwise floats. */

/* The state (S,) one super step after `state` (S,) under `control` (C,); returns whether both states
   are small enough and the control is finite. */
int step(const float *k, const void *state, const float *control, void *next, long is_double) {
    NA_ALIGNED float latent[LATENT], relative[STATE];
    double origin[AXES + 1];
    const int is_given_sound = take_apart(state, is_double, origin, relative) & all_finite(control, CONTROL);
    encode(k, relative, latent);
    super_step(k, latent, control, latent, relative);
    return put_together(origin, relative, state, is_double, next, 0) & is_given_sound;
}

/* `states` (T+1, S): `state` (S,), and the states after each of `steps` super steps under `controls` (T, C). Returns
   whether all states are small enough and all else is finite. */
int rollout(const float *k, const void *state, const float *controls, long steps, void *states, long is_double) {
    NA_ALIGNED float latent[LATENT], relative[STATE];
    double origin[AXES + 1];
    int is_sound = take_apart(state, is_double, origin, relative) & all_finite(controls, steps * CONTROL);
    memcpy(states, state, bytes_of(STATE, is_double));
    encode(k, relative, latent);
    for (long t = 0; t < steps; t++) {
        super_step(k, latent, controls + t * CONTROL, latent, relative);
        is_sound &= put_together(origin, relative, states, is_double, states, t + 1);
        move_origin(origin, latent, 1);
    }
    return is_sound;
}

/* `rollout`, and `scores` (T,): the distance of each step's state and control from training. */
int rollout_trusted(
    const float *k, const void *state, const float *controls, long steps, void *states, float *scores, long is_double
) {
    NA_ALIGNED float latent[LATENT], relative[STATE];
    double origin[AXES + 1];
    int is_sound = take_apart(state, is_double, origin, relative) & all_finite(controls, steps * CONTROL);
    memcpy(states, state, bytes_of(STATE, is_double));
    encode(k, relative, latent);
    for (long t = 0; t < steps; t++) {
        super_step_trusted(k, latent, controls + t * CONTROL, latent, relative, scores + t);
        is_sound &= put_together(origin, relative, states, is_double, states, t + 1);
        move_origin(origin, latent, 1);
    }
    return is_sound;
}
