# Programs that watch themselves. Each kind has a build folder of its own: make test SANITIZE=address, make fuzz.
set(AIR_GROUND_SANITIZE "" CACHE STRING "address, undefined, both (address,undefined) or thread")
option(AIR_GROUND_FUZZ "Build libFuzzer's program, by clang" OFF)

# By how much longer tests may take: a node under ThreadSanitizer takes ten times as long.
set(air_ground_slower 1)
if(AIR_GROUND_SANITIZE)
  set(air_ground_slower 4)
endif()

if(AIR_GROUND_FUZZ)
  set(sanitizers address,undefined,float-cast-overflow)
  add_compile_options(-fsanitize=fuzzer-no-link)
elseif(AIR_GROUND_SANITIZE MATCHES "^(address|undefined|address,undefined|thread)$")
  set(sanitizers ${AIR_GROUND_SANITIZE})
  if(sanitizers MATCHES "undefined")
    string(APPEND sanitizers ",float-cast-overflow")
  endif()
elseif(AIR_GROUND_SANITIZE)
  message(FATAL_ERROR "AIR_GROUND_SANITIZE is '${AIR_GROUND_SANITIZE}', not address, undefined, address,undefined or thread")
endif()

if(sanitizers)
  add_compile_options(-fsanitize=${sanitizers} -fno-sanitize-recover=all -fno-omit-frame-pointer -g1 -O1 -UNDEBUG)
  add_link_options(-fsanitize=${sanitizers})
  # Under AddressSanitizer Eigen aligns memory by hand; the distribution's OpenGV and PCL, built without, free it otherwise.
  add_compile_definitions(EIGEN_MALLOC_ALREADY_ALIGNED=1)
  # The function that chooses a clone runs before the sanitizer is up.
  add_compile_definitions(AIR_GROUND_NO_CLONES)
  # hnswlib prefetches what it reads behind the end of a list of neighbours.
  add_compile_definitions(NO_MANUAL_VECTORIZATION)
endif()
