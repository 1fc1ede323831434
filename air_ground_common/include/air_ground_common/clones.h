// Functions compiled for several instruction sets, of which the processor gets the best at run time.
#pragma once

/// Before the definition of a function on plain arrays (no Eigen type may cross into it, whose alignment differs per
/// clone): it is compiled for each instruction set named, of which "default" must be one. Empty where the compiler
/// knows no clones, on other processors than x86-64, and with AIR_GROUND_NO_CLONES: the code is compiled once.
#define AIR_GROUND_CLONES_FOR(...)
#if defined(__x86_64__) && defined(__has_attribute) && !defined(AIR_GROUND_NO_CLONES)
#if __has_attribute(target_clones)
#undef AIR_GROUND_CLONES_FOR
#define AIR_GROUND_CLONES_FOR(...) __attribute__((target_clones(__VA_ARGS__)))
#endif
#endif

/// The usual ones.
#define AIR_GROUND_CLONES AIR_GROUND_CLONES_FOR("avx512f", "avx2", "default")
