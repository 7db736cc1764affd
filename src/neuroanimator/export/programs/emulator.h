/* The state (@NAME@_STATE numbers) one super step after `state` under `control` (@NAME@_CONTROL numbers). `next` may be
   `state`. */
@NAME@_API void @name@_step(const float *state, const float *control, float *next);

/* The same for `count` bodies: states (count, @NAME@_STATE) and controls (count, @NAME@_CONTROL), one body after the
   other. Sixteen are computed side by side. `next` may be `states`. */
@NAME@_API void @name@_step_batch(const float *states, const float *controls, int count, float *next);

/* `states` (steps + 1, @NAME@_STATE): `state`, and what follows it under `controls` (steps, @NAME@_CONTROL). */
@NAME@_API void @name@_rollout(const float *state, const float *controls, int steps, float *states);

/* Super steps advance latent states (@NAME@_LATENT numbers). For bodies that simply go on, keep the latent states:
   that is faster than encoding states again. */
@NAME@_API void @name@_encode(const float *state, float *latent);

/* Take `count` bodies a super step further: `latents` (count, @NAME@_LATENT) are replaced under controls
   (count, @NAME@_CONTROL), and `states` (count, @NAME@_STATE) are decoded from them. */
@NAME@_API void @name@_advance_batch(float *latents, const float *controls, int count, float *states);

#ifndef @NAME@_WITHOUT_VJP /* half of the program: define this to compile in half the time */
/* The gradients of a number that depends on the next state, by the state and by the control, from its gradient by the
   next state, `cotangent` (@NAME@_STATE). */
@NAME@_API void @name@_vjp(const float *state, const float *control, const float *cotangent, float *by_state, float *by_control);
#endif

/* Distance of `state` and `control` from the training data: 1 is the edge, and the emulator is the less accurate the
   higher it is. Infinite if a number is not finite. */
@NAME@_API float @name@_trust(const float *state, const float *control);

/* Both `step` and, returned, `trust`, for little more than the cost of `step`. `next` may be `state`. */
@NAME@_API float @name@_step_trusted(const float *state, const float *control, float *next);

/* 1 if training covered `state` and `control` (trust is at most 1 and the control within its bounds), else 0: then do not
   rely on the emulator. */
@NAME@_API int @name@_covers(const float *state, const float *control);
