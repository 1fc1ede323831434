# The commands of the suite; each installs what is missing, builds what changed, and runs.
#   make demo       replays an indoor world through roslaunch to one aligned, augmented map; results in out/
#   make demo-city  replays a flight along a street: odometry, localization in a city model, tracking; results in out-city/
#   make test       builds and runs every test, and every benchmark once at its smallest size
#   make bench      prints the benchmarks, as ratios against plain references
#   make build      builds all of it into build/ and devel/
# Works from a plain clone anywhere; inside a catkin workspace use catkin_make or catkin build instead.

SHELL := /bin/bash
ROOT := $(dir $(abspath $(lastword $(MAKEFILE_LIST))))
BUILD := $(ROOT)build
# Beside build/, as in a workspace: rosrun overlooks what lies below a package's folder build/.
DEVEL := $(ROOT)devel
JOBS ?= $(shell nproc)
OUT ?= $(ROOT)out
OUT_CITY ?= $(ROOT)out-city

# Another python3 may stand before the distribution's, which alone knows catkin_pkg and rospy.
export PATH := /usr/bin:$(PATH)
export CCACHE_DIR ?= $(ROOT).cache/ccache
export CCACHE_BASEDIR := $(ROOT)
export AIR_GROUND_CACHE ?= $(ROOT).cache

NOETIC := $(wildcard /opt/ros/noetic/setup.bash)
ENVIRONMENT := $(if $(NOETIC),source $(NOETIC) &&)

.PHONY: build configured benchmarks demo demo-city test bench packages clean

packages:
	@$(ROOT)tools/install_packages

# configure,extra options
configure = $(ENVIRONMENT) cmake -S $(ROOT) -B $(BUILD) -G Ninja -DPYTHON_EXECUTABLE=/usr/bin/python3 \
	-DCATKIN_DEVEL_PREFIX=$(DEVEL) -DCATKIN_ENABLE_TESTING=ON -Wno-dev $(1) > $(BUILD)/configure.log 2>&1 \
	|| { tail -30 $(BUILD)/configure.log; echo "configuring failed: the lines above say why (all of it: $(BUILD)/configure.log)"; exit 1; }

configured: packages
	@mkdir -p $(BUILD) && $(call configure,)

build: configured
	@$(ENVIRONMENT) ninja -C $(BUILD) -j $(JOBS)

demo: configured
	@$(ENVIRONMENT) ninja -C $(BUILD) -j $(JOBS) demo_programs
	@$(ENVIRONMENT) source $(DEVEL)/setup.bash && rosrun air_ground run_demo $(OUT)

demo-city: configured
	@$(ENVIRONMENT) ninja -C $(BUILD) -j $(JOBS) demo_city_programs
	@$(ENVIRONMENT) source $(DEVEL)/setup.bash && rosrun air_ground run_city_demo $(OUT_CITY)

benchmarks: packages
	@mkdir -p $(BUILD) && $(call configure,-DAIR_GROUND_BENCHMARKS=ON)
	@$(ENVIRONMENT) ninja -C $(BUILD) -j $(JOBS)

test: benchmarks
	@$(ENVIRONMENT) source $(DEVEL)/setup.bash && $(ROOT)tools/run_tests $(BUILD) -j $(JOBS)

bench: benchmarks
	@for b in $(BUILD)/bench/*; do echo "== $$(basename $$b)"; "$$b" || exit 1; done

clean:
	rm -rf $(BUILD) $(DEVEL)
