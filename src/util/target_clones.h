// MFIR_TARGET_CLONES before a function: it is compiled for several instruction
// sets, of which the machine's best is used. Not with the thread sanitizer:
// what chooses runs before the sanitizer is there.

#pragma once

#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && \
    !defined(__SANITIZE_THREAD__)
#define MFIR_TARGET_CLONES \
  __attribute__((target_clones("default", "arch=haswell", "arch=x86-64-v4")))
#else
#define MFIR_TARGET_CLONES
#endif
