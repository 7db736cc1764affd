/* A school of fish that is asked over a pipe: cc -O2 fish_server.c -o fish_server -lm

   fish_server COUNT reads, for every super step, commands (COUNT, 4) as float32 from its input: forward speed [m/s], and
   how far still to turn left, to pitch up and to roll over to the right [rad]. It answers with states (COUNT, FISH_STATE)
   as float32. It ends with its input. */
#define FISH_IMPLEMENTATION
#define FISH_WITHOUT_VJP
#define SWIM_IMPLEMENTATION
#include "fish.h"
#include "swim.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#if defined(_WIN32)
#include <fcntl.h>
#include <io.h>
#endif

enum { MAX_COUNT = 100000 };

int main(int arguments, char **words) {
    const int count = arguments == 2 ? atoi(words[1]) : 0;
    if (count < 1 || count > MAX_COUNT) {
        fprintf(stderr, "fish_server COUNT: wanted a number of fish from 1 to %d\n", MAX_COUNT);
        return 2;
    }
#if defined(_WIN32)
    _setmode(_fileno(stdin), _O_BINARY);
    _setmode(_fileno(stdout), _O_BINARY);
#endif
    const size_t fish = (size_t)count;
    float *states = malloc(fish * FISH_STATE * sizeof *states);
    float *latents = malloc(fish * FISH_LATENT * sizeof *latents);
    float *controls = malloc(fish * FISH_CONTROL * sizeof *controls);
    float *commands = malloc(fish * 4 * sizeof *commands);
    if (!states || !latents || !controls || !commands) {
        fprintf(stderr, "fish_server: there is no memory for %d fish\n", count);
        return 4;
    }
    for (int i = 0; i < count; i++) {
        memcpy(states + i * FISH_STATE, fish_rest, sizeof fish_rest);
        fish_encode(fish_rest, latents + i * FISH_LATENT);
    }
    float phase = 0.0f;
    while (fread(commands, 4 * sizeof *commands, fish, stdin) == fish) {
        for (int i = 0; i < count; i++)
            swim_control(states + i * FISH_STATE, phase, commands + i * 4, controls + i * FISH_CONTROL);
        fish_advance_batch(latents, controls, count, states);
        phase = fmodf(phase + SWIM_PHASE_PER_STEP, 6.2831853f);
        if (fwrite(states, FISH_STATE * sizeof *states, fish, stdout) != fish || fflush(stdout)) return 1;
    }
    free(states);
    free(latents);
    free(controls);
    free(commands);
    return 0;
}
