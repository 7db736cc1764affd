/* The fish and its policy as a shared library. cc -O2 -shared -fPIC fish_library.c -o libfish.so -lm */
#if defined(_WIN32)
#define FISH_API __declspec(dllexport)
#define SWIM_API __declspec(dllexport)
#endif
#define FISH_IMPLEMENTATION
#define FISH_WITHOUT_VJP
#define SWIM_IMPLEMENTATION
#include "fish.h"
#include "swim.h"
