/* Sixteen motions in parallel. Numbers are in the units of the emulator's state and control. */

/* `states` (B, T+1, S): `count` motions of `steps` super steps from `starts` (B, S) under `controls` (B, T, C).
   Returns whether all starts are small enough and all else is finite. */
int rollouts(const float *k, const float *starts, const float *controls, long count, long steps, float *states) {
    NA_ALIGNED float latent[LATENT * LANES], state[STATE * LANES], one[LATENT];
    NA_ALIGNED float control[(CONTROL > 0 ? CONTROL : 1) * LANES];
    for (long first = 0; first < count; first += LANES) {
        const long present = count - first < LANES ? count - first : LANES;
        for (long l = 0; l < LANES; l++) {
            /* Surplus lanes repeat the last motion. */
            const float *start = starts + (first + (l < present ? l : present - 1)) * STATE;
            encode(k, start, one);
            for (int i = 0; i < LATENT; i++) latent[i * LANES + l] = one[i];
            if (l < present) memcpy(states + (first + l) * (steps + 1) * STATE, start, STATE * sizeof(float));
        }
        for (long t = 0; t < steps; t++) {
            for (long l = 0; l < LANES; l++) {
                const float *held = controls + ((first + (l < present ? l : present - 1)) * steps + t) * CONTROL;
                for (int i = 0; i < CONTROL; i++) control[i * LANES + l] = held[i];
            }
            super_step_lanes(k, latent, control, latent, state);
            for (long l = 0; l < present; l++) {
                float *next = states + ((first + l) * (steps + 1) + t + 1) * STATE;
                for (int i = 0; i < STATE; i++) next[i] = state[i * LANES + l];
            }
        }
    }
    const int are_given_sound = all_below(starts, count * STATE, MAX_MAGNITUDE) & all_finite(controls, count * steps * CONTROL);
    return are_given_sound & all_finite(states, count * (steps + 1) * STATE);
}
