/* `control` (@NAME@_CONTROL numbers), to be held for one super step, of a body in `state` (@NAME@_STATE numbers). */
@NAME@_API void @name@_control(const float *state, float *control);
