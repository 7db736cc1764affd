/* Positions on which nothing depends are computed relative to an origin, so that they keep their digits far away and on long
   ways. In a latent state it is the sum of two floats: the first entry along each axis, and those behind the rest. */
static void @name@_take_apart(const float *state, double *origin, float *relative) {
    for (int i = 0; i < @NAME@_STATE; i++) relative[i] = state[i];
    for (int a = 0; a < @NAME@_AXES; a++) origin[a] = (double)state[@name@_state_first[a]];
    for (int p = 0; p < @NAME@_MOVED_STATE; p++) {
        const int entry = @name@_state_entry[p];
        relative[entry] = (float)((double)state[entry] - origin[@name@_state_axis[p]]);
    }
}

static void @name@_put_together(const double *origin, float *state) {
    for (int p = 0; p < @NAME@_MOVED_STATE; p++) {
        const int entry = @name@_state_entry[p];
        state[entry] = (float)(origin[@name@_state_axis[p]] + (double)state[entry]);
    }
}

/* Moves `origin` to the first entry of `latent` along each axis. */
static void @name@_move_origin(double *origin, float *latent) {
    float way[@NAME@_AXES + 1];
    for (int a = 0; a < @NAME@_AXES; a++) {
        way[a] = latent[@name@_latent_first[a]];
        origin[a] += (double)way[a];
    }
    for (int p = 0; p < @NAME@_MOVED_LATENT; p++) latent[@name@_latent_entry[p]] -= way[@name@_latent_axis[p]];
}

static void @name@_store(double *origin, float *latent, float *stored) {
    @name@_move_origin(origin, latent);
    for (int i = 0; i < @NAME@_NUMBERS; i++) stored[i] = latent[i];
    for (int a = 0; a < @NAME@_AXES; a++) {
        const float high = (float)origin[a];
        stored[@name@_latent_first[a]] = high;
        stored[@NAME@_NUMBERS + a] = (float)(origin[a] - (double)high);
    }
}

static void @name@_restore(const float *stored, double *origin, float *latent) {
    for (int i = 0; i < @NAME@_NUMBERS; i++) latent[i] = stored[i];
    for (int a = 0; a < @NAME@_AXES; a++) {
        const int first = @name@_latent_first[a];
        origin[a] = (double)stored[first] + (double)stored[@NAME@_NUMBERS + a];
        latent[first] = 0.0f;
    }
}

static void @name@_begin(const float *state, double *origin, float *latent) {
    float relative[@NAME@_STATE];
    @name@_take_apart(state, origin, relative);
    @name@_encoded(@name@_k, relative, latent);
}

@NAME@_API void @name@_encode(const float *state, float *latent) {
    NA_ALIGNED float own[@NAME@_NUMBERS];
    double origin[@NAME@_AXES + 1];
    @name@_begin(state, origin, own);
    @name@_store(origin, own, latent);
}

@NAME@_API void @name@_step(const float *state, const float *control, float *next) {
    NA_ALIGNED float latent[@NAME@_NUMBERS];
    double origin[@NAME@_AXES + 1];
    @name@_begin(state, origin, latent);
    @name@_super_step(@name@_k, latent, control, latent, next);
    @name@_put_together(origin, next);
}

@NAME@_API void @name@_rollout(const float *state, const float *controls, int steps, float *states) {
    NA_ALIGNED float latent[@NAME@_NUMBERS];
    double origin[@NAME@_AXES + 1];
    for (int i = 0; i < @NAME@_STATE; i++) states[i] = state[i];
    @name@_begin(state, origin, latent);
    for (int t = 0; t < steps; t++) {
        states += @NAME@_STATE;
        @name@_super_step(@name@_k, latent, controls, latent, states);
        @name@_put_together(origin, states);
        @name@_move_origin(origin, latent);
        controls += @NAME@_CONTROL;
    }
}

/* Up to sixteen bodies, side by side. */
static void @name@_advance_lanes(float *latents, const float *controls, int count, float *states) {
    NA_SCRATCH NA_ALIGNED float latent[@NAME@_NUMBERS * LANES];
    NA_SCRATCH NA_ALIGNED float control[(@NAME@_CONTROL > 0 ? @NAME@_CONTROL : 1) * LANES];
    NA_SCRATCH NA_ALIGNED float state[@NAME@_STATE * LANES];
    float own[@NAME@_NUMBERS];
    double origins[LANES][@NAME@_AXES + 1];
    for (int l = 0; l < LANES; l++) {
        const int body = l < count ? l : count - 1; /* unused lanes repeat the last body */
        @name@_restore(latents + body * @NAME@_LATENT, origins[l], own);
        for (int i = 0; i < @NAME@_NUMBERS; i++) latent[i * LANES + l] = own[i];
        for (int i = 0; i < @NAME@_CONTROL; i++) control[i * LANES + l] = controls[body * @NAME@_CONTROL + i];
    }
    @name@_super_step_lanes(@name@_k, latent, control, latent, state);
    for (int l = 0; l < count; l++) {
        for (int i = 0; i < @NAME@_STATE; i++) states[l * @NAME@_STATE + i] = state[i * LANES + l];
        @name@_put_together(origins[l], states + l * @NAME@_STATE);
        for (int i = 0; i < @NAME@_NUMBERS; i++) own[i] = latent[i * LANES + l];
        @name@_store(origins[l], own, latents + l * @NAME@_LATENT);
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
    NA_SCRATCH float latents[@NAME@_LATENT * LANES];
    for (; count > 0; count -= LANES) {
        const int present = count < LANES ? count : LANES;
        for (int l = 0; l < present; l++) @name@_encode(states + l * @NAME@_STATE, latents + l * @NAME@_LATENT);
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
    NA_ALIGNED float latent[@NAME@_NUMBERS];
    double origin[@NAME@_AXES + 1];
    float score;
    int is_number = 1;
    for (int i = 0; i < @NAME@_STATE; i++) is_number &= fabsf(state[i]) <= @NAME@_MAX_MAGNITUDE;
    for (int i = 0; i < @NAME@_CONTROL; i++) is_number &= fabsf(control[i]) <= @NAME@_MAX_MAGNITUDE;
    @name@_begin(state, origin, latent);
    @name@_super_step_trusted(@name@_k, latent, control, latent, next, &score);
    @name@_put_together(origin, next);
    return is_number && fabsf(score) < INFINITY ? score : INFINITY;
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
