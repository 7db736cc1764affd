/* What an emulator's module can do (export/programs/emulator.h), done by the physics itself: whatever shows or steers the
   one does so with the other. Numbers come and go as float32; the physics is in REAL.

   The text that wasm_module.py puts before this one says NAME, and how a super step is made: by INTEGRATOR in STEPS physics
   steps of DT [s], and by USUAL_INTEGRATOR, USUAL_STEPS and USUAL_DT as a user would run it. */

#define JOINED(name, function) name##_##function
#define CALLED(name, function) JOINED(name, function)
#define API(function) CALLED(NAME, function)

/* Write the states after each of `count` controls; `next` may be `state`. Written out where it is called, so that a module has
   the one integrator it goes by, and not all of them. */
static inline __attribute__((always_inline)) void follow(
    int integrator, long steps, double dt, const float *state, const float *controls, int count, float *next
) {
    real wide_state[STATE], wide_control[ROOM(CONTROLS)];
    Numbers numbers ALIGNED;
    BodyState m ALIGNED;
    for (int i = 0; i < STATE; i++) wide_state[i] = state[i];
    read_state(wide_state, &m, &numbers);
    for (int t = 0; t < count; t++) {
        for (int i = 0; i < CONTROLS; i++) wide_control[i] = controls[t * CONTROLS + i];
        hold(&m, wide_control);
        run(integrator, &m, steps, dt);
        write_state(&m, wide_state);
        for (int i = 0; i < STATE; i++) next[t * STATE + i] = (float)wide_state[i];
    }
}

static void go_on(const float *state, const float *controls, int count, float *next) {
    follow(INTEGRATOR, STEPS, DT, state, controls, count, next);
}

void API(step)(const float *state, const float *control, float *next) { go_on(state, control, 1, next); }

void API(rollout)(const float *state, const float *controls, int steps, float *states) {
    memcpy(states, state, STATE * sizeof(float));
    go_on(state, controls, steps, states + STATE);
}

void API(rollout_usual)(const float *state, const float *controls, int steps, float *states) {
    memcpy(states, state, STATE * sizeof(float));
    follow(USUAL_INTEGRATOR, USUAL_STEPS, USUAL_DT, state, controls, steps, states + STATE);
}

/* A latent state is the state. */
void API(encode)(const float *state, float *latent) { memcpy(latent, state, STATE * sizeof(float)); }

void API(advance_batch)(float *latents, const float *controls, int count, float *states) {
    for (int body = 0; body < count; body++) {
        float *latent = latents + body * STATE;
        go_on(latent, controls + body * CONTROLS, 1, latent);
        memcpy(states + body * STATE, latent, STATE * sizeof(float));
    }
}

/* Physics is true wherever it has numbers to go on from. */
int API(covers)(const float *state, const float *control) {
    for (int i = 0; i < STATE; i++)
        if (!isfinite(state[i])) return 0;
    for (int i = 0; i < CONTROLS; i++)
        if (!isfinite(control[i])) return 0;
    return 1;
}
