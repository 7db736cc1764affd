/* `control` (@NAME@_CONTROL numbers), to be held for one super step, of a body in `state` (@NAME@_STATE numbers).
   `command` is two numbers: speed [m/s], and turn rate to the left [rad/s]. They are part of the state:
   `commanded_state` (@NAME@_STATE numbers) is the state with them in it, from which the super step begins. */
@NAME@_API void @name@_control(const float *state, const float *command, float *control, float *commanded_state);
