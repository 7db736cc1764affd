@NAME@_API void @name@_encode(const float *state, float *latent) {
    @name@_encoded(@name@_k, state, latent);
}

@NAME@_API void @name@_step(const float *state, const float *control, float *next) {
    NA_ALIGNED float latent[@NAME@_LATENT];
    @name@_encoded(@name@_k, state, latent);
    @name@_super_step(@name@_k, latent, control, latent, next);
}

@NAME@_API void @name@_rollout(const float *state, const float *controls, int steps, float *states) {
    NA_ALIGNED float latent[@NAME@_LATENT];
    for (int i = 0; i < @NAME@_STATE; i++) states[i] = state[i];
    @name@_encoded(@name@_k, state, latent);
    for (int t = 0; t < steps; t++) {
        states += @NAME@_STATE;
        @name@_super_step(@name@_k, latent, controls, latent, states);
        controls += @NAME@_CONTROL;
    }
}

/* Up to sixteen bodies, side by side. */
static void @name@_advance_lanes(float *latents, const float *controls, int count, float *states) {
    NA_ALIGNED float latent[@NAME@_LATENT * LANES];
    NA_ALIGNED float control[(@NAME@_CONTROL > 0 ? @NAME@_CONTROL : 1) * LANES];
    NA_ALIGNED float state[@NAME@_STATE * LANES];
    for (int l = 0; l < LANES; l++) {
        const int body = l < count ? l : count - 1; /* unused lanes repeat the last body */
        for (int i = 0; i < @NAME@_LATENT; i++) latent[i * LANES + l] = latents[body * @NAME@_LATENT + i];
        for (int i = 0; i < @NAME@_CONTROL; i++) control[i * LANES + l] = controls[body * @NAME@_CONTROL + i];
    }
    @name@_super_step_lanes(@name@_k, latent, control, latent, state);
    for (int l = 0; l < count; l++) {
        for (int i = 0; i < @NAME@_LATENT; i++) latents[l * @NAME@_LATENT + i] = latent[i * LANES + l];
        for (int i = 0; i < @NAME@_STATE; i++) states[l * @NAME@_STATE + i] = state[i * LANES + l];
    }
}

@NAME@_API void @name@_advance_batch(float *latents, const float *controls, int count, float *states) {
    for (; count > 0; count -= LANES) {
        @name@_advance_lanes(latents, controls, count < LANES ? count : LANES, states);
        latents += LANES * @NAME@_LATENT;
        controls += LANES * @NAME@_CONTROL;
        states += LANES * @NAME@_STATE;
    }
}

@NAME@_API void @name@_step_batch(const float *states, const float *controls, int count, float *next) {
    NA_ALIGNED float latents[@NAME@_LATENT * LANES];
    for (; count > 0; count -= LANES) {
        const int present = count < LANES ? count : LANES;
        for (int l = 0; l < present; l++) @name@_encoded(@name@_k, states + l * @NAME@_STATE, latents + l * @NAME@_LATENT);
        @name@_advance_lanes(latents, controls, present, next);
        states += LANES * @NAME@_STATE;
        controls += LANES * @NAME@_CONTROL;
        next += LANES * @NAME@_STATE;
    }
}

#ifndef @NAME@_WITHOUT_VJP
@NAME@_API void @name@_vjp(const float *state, const float *control, const float *cotangent, float *by_state, float *by_control) {
    NA_ALIGNED float tape[@NAME@_TAPE];
    float lanes = 0.0f; /* no tape of lanes: there are none here */
    @name@_gradient_forward(@name@_k, state, control, tape, &lanes);
    @name@_gradient_backward(@name@_k, tape, &lanes, cotangent, by_state, by_control);
}
#endif

@NAME@_API float @name@_step_trusted(const float *state, const float *control, float *next) {
    NA_ALIGNED float latent[@NAME@_LATENT];
    float score;
    int is_number = 1;
    for (int i = 0; i < @NAME@_STATE; i++) is_number &= fabsf(state[i]) <= @NAME@_MAX_MAGNITUDE;
    for (int i = 0; i < @NAME@_CONTROL; i++) is_number &= fabsf(control[i]) <= @NAME@_MAX_MAGNITUDE;
    @name@_encoded(@name@_k, state, latent);
    @name@_super_step_trusted(@name@_k, latent, control, latent, next, &score);
    return is_number && score - score == 0.0f ? score : INFINITY;
}

@NAME@_API float @name@_trust(const float *state, const float *control) {
    float next[@NAME@_STATE];
    return @name@_step_trusted(state, control, next);
}

@NAME@_API int @name@_covers(const float *state, const float *control) {
    for (int i = 0; i < @NAME@_CONTROL; i++) {
        const float low = @name@_control_low[i];
        const float high = @name@_control_high[i];
        const float slack = 1e-6f * (fabsf(low) > fabsf(high) ? fabsf(low) : fabsf(high));
        if (!(control[i] >= low - slack && control[i] <= high + slack)) return 0;
    }
    return @name@_trust(state, control) <= 1.0f;
}
