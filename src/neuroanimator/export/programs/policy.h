/* `control` (@NAME@_CONTROL numbers), to be held for one super step, of a body in `state` (@NAME@_STATE numbers).
   `phase` is that of a clock that gains @NAME@_PHASE_PER_STEP with every super step [rad]. `command` are four numbers:
   forward speed [m/s], and how far still to turn left, to pitch up and to roll over to the right [rad]. */
@NAME@_API void @name@_control(const float *state, float phase, const float *command, float *control);
