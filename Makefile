# The commands of the suite; each installs what is missing, builds what changed, and runs.
#   make demo       replays an indoor world through roslaunch to one aligned, augmented map; results in out/
#   make demo-city  replays a flight along a street: odometry, localization in a city model, tracking; results in out-city/
#   make test       builds and runs every test, and every benchmark once at its smallest size
#   make test SANITIZE=address    the same, watched for bad accesses and leaks (or undefined: undefined behaviour; address,undefined: both; thread: data races)
#   make fuzz       feeds hostile files and messages to every reader; FUZZ_SECONDS=60 each, FUZZ_TARGETS="obj ply" for some
#   make bench      prints the benchmarks, as ratios against plain references
#   make tidy       looks for hidden mistakes with clang-tidy (.clang-tidy), in what is no test: half an hour on two cores
#   make docs       pages of the libraries' interfaces, by Doxygen: build/doxygen/html/index.html
#   make build      builds all of it into build/ and devel/
# Works from a plain clone anywhere but below a folder with a space in its name; inside a catkin workspace use catkin_make or catkin build instead.

SHELL := /bin/bash
# make splits names at spaces: what is built, and what make clean removes, would lie beside this folder.
ifneq ($(words $(abspath $(MAKEFILE_LIST))),1)
$(error there is a space in the path of this folder, which neither make nor catkin can handle: move the clone)
endif
ROOT := $(dir $(abspath $(lastword $(MAKEFILE_LIST))))
SANITIZE ?=
# Below build/, which rosrun overlooks: what lies beside would be found as a second program of each name. A linker's option (-rpath)
# ends at a comma.
comma := ,
BUILD := $(ROOT)build$(addprefix /,$(subst $(comma),-,$(SANITIZE)))
DEVEL = $(if $(filter $(ROOT)build,$(BUILD)),$(ROOT)devel,$(BUILD)/devel)
FUZZ_SECONDS ?= 20
FUZZ_TARGETS ?=
JOBS ?= $(shell nproc)
# One is a rostest, whose nodes wait for each other half of the time.
TEST_JOBS ?= $(shell expr $(JOBS) + 1)
OUT ?= $(ROOT)out
OUT_CITY ?= $(ROOT)out-city

# Another python3 may stand before the distribution's, which alone knows catkin_pkg and rospy.
export PATH := /usr/bin:$(PATH)
export CCACHE_DIR ?= $(ROOT).cache/ccache
export CCACHE_BASEDIR := $(ROOT)
export AIR_GROUND_CACHE ?= $(ROOT).cache

# What is excused and why: in the files.
export LSAN_OPTIONS := suppressions=$(ROOT)test/sanitizers/leak.supp:print_suppressions=0
export TSAN_OPTIONS := suppressions=$(ROOT)test/sanitizers/thread.supp:history_size=4
export UBSAN_OPTIONS := print_stacktrace=1
ifeq ($(SANITIZE),thread)
export OMP_THREAD_LIMIT := 1
endif

# Of a Noetic that was built from its sources: make NOETIC=... demo
export NOETIC ?= /opt/ros/noetic
ENVIRONMENT := $(if $(wildcard $(NOETIC)/setup.bash),source $(NOETIC)/setup.bash &&)

.PHONY: build configured benchmarks demo demo-city test bench fuzz tidy docs packages clean

packages:
	@$(ROOT)tools/install_packages

# configure,extra options: and the messages, first, since ninja looks at their headers once, when it starts, and ccache writes their
# paths in another way.
configure = mkdir -p $(BUILD) && $(ENVIRONMENT) cmake -S $(ROOT) -B $(BUILD) -G Ninja -DPYTHON_EXECUTABLE=/usr/bin/python3 \
	-DCATKIN_DEVEL_PREFIX=$(DEVEL) -DCATKIN_ENABLE_TESTING=ON -DAIR_GROUND_SANITIZE=$(SANITIZE) -Wno-dev $(1) > $(BUILD)/configure.log 2>&1 \
	|| { tail -30 $(BUILD)/configure.log; echo "configuring failed: the lines above say why (all of it: $(BUILD)/configure.log)"; exit 1; } \
	&& $(ENVIRONMENT) ninja --quiet -C $(BUILD) -j $(JOBS) air_ground_generate_messages_cpp

configured: packages
	@$(call configure,)

build: configured
	@$(ENVIRONMENT) ninja -C $(BUILD) -j $(JOBS)

demo: configured
	@$(ENVIRONMENT) ninja -C $(BUILD) -j $(JOBS) demo_programs
	@$(ENVIRONMENT) source $(DEVEL)/setup.bash && rosrun air_ground run_demo "$(OUT)"

demo-city: configured
	@$(ENVIRONMENT) ninja -C $(BUILD) -j $(JOBS) demo_city_programs
	@$(ENVIRONMENT) source $(DEVEL)/setup.bash && rosrun air_ground run_city_demo "$(OUT_CITY)"

benchmarks: packages
	@$(call configure,-DAIR_GROUND_BENCHMARKS=ON)
	@$(ENVIRONMENT) ninja -C $(BUILD) -j $(JOBS)

test: benchmarks
	@$(ENVIRONMENT) source $(DEVEL)/setup.bash && $(ROOT)tools/run_tests $(BUILD) -j $(TEST_JOBS)

bench: benchmarks
	@for b in $(BUILD)/bench/*; do echo "== $$(basename $$b)"; "$$b" || exit 1; done

# By clang, whose libFuzzer it is. Static: one program whose coverage libFuzzer sees whole.
fuzz: BUILD := $(ROOT)build/fuzz
fuzz:
	@$(ROOT)tools/install_packages clang-14 libclang-rt-14-dev libomp-14-dev
	@$(call configure,-DCMAKE_C_COMPILER=clang-14 -DCMAKE_CXX_COMPILER=clang++-14 -DAIR_GROUND_FUZZ=ON -DBUILD_SHARED_LIBS=OFF)
	@$(ENVIRONMENT) ninja -C $(BUILD) -j $(JOBS) air_ground_fuzz_exe
	@FUZZ_SECONDS=$(FUZZ_SECONDS) $(ROOT)tools/run_fuzzers $(DEVEL)/lib/air_ground/fuzz $(BUILD)/corpus $(FUZZ_TARGETS)

# Not in make test: seven seconds a file. Without headers precompiled by another compiler.
tidy: BUILD := $(ROOT)build/tidy
tidy: packages
	@$(ROOT)tools/install_packages clang-tidy-14
	@$(call configure,-DAIR_GROUND_PRECOMPILE=OFF)
	@cd $(ROOT) && run-clang-tidy-14 -quiet -p $(BUILD) -j $(JOBS) '^$(ROOT)[a-z_/]*/src/.*\.cpp$$' > $(BUILD)/tidy.log 2>&1 && echo 'make tidy: nothing found' \
		|| { grep -E -A3 '(warning|error): ' $(BUILD)/tidy.log; echo "make tidy: all of it in $(BUILD)/tidy.log"; exit 1; }

docs:
	@$(ROOT)tools/install_packages doxygen
	@mkdir -p $(ROOT)build && cd $(ROOT) && doxygen Doxyfile && echo $(ROOT)build/doxygen/html/index.html

clean:
	rm -rf $(ROOT)build $(ROOT)devel
