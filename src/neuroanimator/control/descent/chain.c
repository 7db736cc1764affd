/* A chain of super steps with a defect added to each, and its derivative. `latent` (I,) is where it starts; states
   (T+1, S) have the start's row written by the caller. What is `lanes` has sixteen numbers for each one. */

/* `states` from row 1 on, under `controls` (T, C) with `defects` (T, V); `tapes` (T, TAPE) is for `chain_backward`. */
void chain_forward(
    const float *k, const float *start, const float *controls, const float *defects, long steps, float *tapes, float *states
) {
    NA_ALIGNED float latent[LATENT], nothing[LANES];
    memcpy(latent, start, sizeof latent);
    for (long t = 0; t < steps; t++)
        advance_forward(
            k, latent, controls + t * CONTROL, defects + t * DEFECT, tapes + t * TAPE, nothing, latent, states + (t + 1) * STATE
        );
}

/* `after` (T, I): where one super step leads from each of `latents` (T, I) under `controls` (T, C), without defects. */
void chain_apart(const float *k, const float *latents, const float *controls, long count, float *after) {
    NA_ALIGNED float defect[DEFECT] = {0}, tape[TAPE], nothing[LANES], state[STATE];
    for (long t = 0; t < count; t++)
        advance_forward(
            k, latents + t * LATENT, controls + t * CONTROL, defect, tape, nothing, after + t * LATENT, state
        );
}

/* Add to `controls` lanes (T, C) what cotangents `states` lanes (T+1, S) of sixteen numbers say of the controls; the
   cotangents of states after the first `last` super steps are zero, so that these need not be looked at. */
void chain_backward(const float *k, const float *tapes, const float *states, long last, float *controls) {
    NA_ALIGNED float latent[LATENT * LANES], control[CONTROL * LANES], nothing[LANES];
    memset(latent, 0, sizeof latent);
    for (long t = last - 1; t >= 0; t--) {
        advance_backward(k, tapes + t * TAPE, nothing, latent, states + (t + 1) * STATE * LANES, latent, control);
        for (int i = 0; i < CONTROL * LANES; i++) controls[t * CONTROL * LANES + i] += control[i];
    }
}

/* `states` (B, T+1, S) from row 1 on, of `count` motions, at most sixteen, from one start under `controls` (B, T, C). */
void chain_lanes(
    const float *k, const float *start, const float *controls, const float *defects, long count, long steps, float *states
) {
    NA_ALIGNED float latent[LATENT * LANES], control[CONTROL * LANES], state[STATE * LANES];
    for (int i = 0; i < LATENT; i++)
        for (int l = 0; l < LANES; l++) latent[i * LANES + l] = start[i];
    for (long t = 0; t < steps; t++) {
        /* Lanes too many repeat the last motion. */
        for (long l = 0; l < LANES; l++)
            for (int i = 0; i < CONTROL; i++)
                control[i * LANES + l] = controls[((l < count ? l : count - 1) * steps + t) * CONTROL + i];
        advance_lanes(k, latent, control, defects + t * DEFECT, latent, state);
        for (long l = 0; l < count; l++)
            for (int i = 0; i < STATE; i++) states[(l * (steps + 1) + t + 1) * STATE + i] = state[i * LANES + l];
    }
}
