/* `control` (@NAME@_CONTROL numbers), to be held for one super step, of a body in `state` (@NAME@_STATE numbers).
   `phase` is that of a clock that advances by @NAME@_PHASE_PER_STEP with every super step [rad]. `command` is four numbers:
   forward speed [m/s], and the angles left to turn left, pitch up and roll to the right [rad]. */
@NAME@_API void @name@_control(const float *state, float phase, const float *command, float *control);
