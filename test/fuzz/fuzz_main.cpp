// libFuzzer's entry: AIR_GROUND_FUZZ_TARGET names the target; without it the names are printed. See tools/run_fuzzers.
#include <cstdio>
#include <cstdlib>

#include "fuzzing.h"

namespace {

air_ground_fuzz::Target target;

}  // namespace

extern "C" int LLVMFuzzerInitialize(int*, char***) {
  const air_ground_fuzz::Targets targets = air_ground_fuzz::allTargets();
  const char* name = std::getenv("AIR_GROUND_FUZZ_TARGET");
  if (name && targets.count(name)) {
    target = targets.at(name);
    return 0;
  }
  for (const auto& entry : targets) std::puts(entry.first.c_str());
  std::exit(name ? 1 : 0);
}

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  target(air_ground_fuzz::Bytes(data, data + size));
  return 0;
}
