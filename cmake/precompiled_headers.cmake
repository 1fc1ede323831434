# What nearly every file reads, precompiled once for each kind of target: about a sixth of the compilers' time.
# Off where each file shall show that it includes what it uses (make tidy).
option(AIR_GROUND_PRECOMPILE "Precompile the headers that most files read" ON)

# One set of flags for all, since a precompiled header serves no other. Eigen's own threads would come with OpenMP, and
# wait for each other in every node.
set(CMAKE_POSITION_INDEPENDENT_CODE OFF)
add_compile_options(-fPIC ${OpenMP_CXX_FLAGS})
add_compile_definitions(EIGEN_DONT_PARALLELIZE)
if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
  # Most files need 0.5 GB: until then GCC looks for garbage in vain, 5 to 17 % of its time.
  add_compile_options("SHELL:--param ggc-min-heapsize=2000000")
endif()

if(AIR_GROUND_PRECOMPILE AND CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
  add_compile_options(-fpch-preprocess)  # ccache asks for it
endif()

set(plain_headers <algorithm> <array> <cmath> <fstream> <functional> <map> <memory> <optional> <random> <sstream> <string>
  <unordered_map> <vector> <Eigen/Core> <Eigen/Geometry> <Eigen/LU> <opencv2/core.hpp>)

# air_ground_precompiled_headers(<kind> [HEADERS <headers>] [LINK <targets>]): the plain headers and the kind's own, in a target
# that has no code.
function(air_ground_precompiled_headers KIND)
  cmake_parse_arguments(ARG "" "" "HEADERS;LINK" ${ARGN})
  if(NOT AIR_GROUND_PRECOMPILE)
    return()
  endif()
  set(source ${CMAKE_BINARY_DIR}/precompiled_${KIND}.cpp)
  file(GENERATE OUTPUT ${source} CONTENT "")
  add_library(air_ground_precompiled_${KIND} OBJECT ${source})
  target_link_libraries(air_ground_precompiled_${KIND} PRIVATE Eigen3::Eigen opencv_core ${ARG_LINK})
  target_precompile_headers(air_ground_precompiled_${KIND} PRIVATE ${plain_headers} ${ARG_HEADERS})
endfunction()

# air_ground_precompile(<target> <kind>)
function(air_ground_precompile TARGET KIND)
  if(AIR_GROUND_PRECOMPILE)
    target_precompile_headers(${TARGET} REUSE_FROM air_ground_precompiled_${KIND})
  endif()
endfunction()

air_ground_precompiled_headers(plain)
if(CATKIN_ENABLE_TESTING)
  air_ground_precompiled_headers(test HEADERS <gtest/gtest.h> LINK GTest::gtest)
endif()
air_ground_precompiled_headers(ros HEADERS <ros/ros.h>
  <nav_msgs/Odometry.h> <sensor_msgs/CameraInfo.h> <sensor_msgs/Image.h> <sensor_msgs/Imu.h> <sensor_msgs/PointCloud2.h>
  <std_srvs/Trigger.h> <tf2_ros/transform_broadcaster.h>
  LINK ${catkin_LIBRARIES})
