/* A thousand fish swim to a place each for ten seconds. cc -O2 school.c -o school -lm && ./school */
#define FISH_IMPLEMENTATION
#define FISH_WITHOUT_VJP
#define SWIM_IMPLEMENTATION
#include "fish.h"
#include "swim.h"

#include <math.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

enum { COUNT = 1000, SUPER_STEPS = 100 };

static float states[COUNT * FISH_STATE];
static float latents[COUNT * FISH_LATENT];
static float controls[COUNT * FISH_CONTROL];

/* How far the fish still has to turn left to swim to (x, y) [rad]. */
static float turn_to(const float *fish, float x, float y) {
    const float *nose = fish + FISH_STATE_NOSE;
    const float *tail = fish + FISH_STATE_TAIL_UP;
    const float ahead_x = nose[0] - tail[0];
    const float ahead_y = nose[1] - tail[1];
    const float to_x = x - nose[0];
    const float to_y = y - nose[1];
    return atan2f(ahead_x * to_y - ahead_y * to_x, ahead_x * to_x + ahead_y * to_y);
}

static float mean_distance(void) {
    float sum = 0.0f;
    for (int i = 0; i < COUNT; i++) {
        const float *nose = states + i * FISH_STATE + FISH_STATE_NOSE;
        sum += hypotf(cosf((float)i) - nose[0], sinf((float)i) - nose[1]);
    }
    return sum / COUNT;
}

int main(void) {
    for (int i = 0; i < COUNT; i++) {
        memcpy(states + i * FISH_STATE, fish_rest, sizeof fish_rest);
        fish_encode(fish_rest, latents + i * FISH_LATENT);
    }
    printf("%.3f m to go\n", mean_distance());
    const clock_t began = clock();
    for (int step = 0; step < SUPER_STEPS; step++) {
        const float phase = (float)step * SWIM_PHASE_PER_STEP;
        for (int i = 0; i < COUNT; i++) {
            const float *fish = states + i * FISH_STATE;
            const float command[4] = {0.14f, turn_to(fish, cosf((float)i), sinf((float)i)), 0.0f, 0.0f};
            swim_control(fish, phase, command, controls + i * FISH_CONTROL);
        }
        fish_advance_batch(latents, controls, COUNT, states);
    }
    const double seconds = (double)(clock() - began) / CLOCKS_PER_SEC;
    printf("%.3f m to go\n", mean_distance());
    printf("%.1f us a fish and super step of %g s\n", 1e6 * seconds / (COUNT * SUPER_STEPS), FISH_DT);
    return 0;
}
