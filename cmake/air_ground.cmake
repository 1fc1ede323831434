# Helpers that keep each module's CMakeLists.txt to a few lines. All targets carry the prefix air_ground_.

# air_ground_library(NAME <name> SOURCES <files> [LINK <targets>] [ROS])
# A library target air_ground_<name> with its headers in include/; ROS-free unless it is said to be ROS. GCC's alignment of Eigen types
# stays baseline.
function(air_ground_library)
  cmake_parse_arguments(ARG "ROS" "NAME" "SOURCES;LINK" ${ARGN})
  set(target air_ground_${ARG_NAME})
  add_library(${target} ${ARG_SOURCES})
  if(ARG_ROS)
    air_ground_precompile(${target} ros)
  else()
    air_ground_precompile(${target} plain)
  endif()
  target_include_directories(${target} PUBLIC ${CMAKE_CURRENT_SOURCE_DIR}/include)
  target_link_libraries(${target} PUBLIC ${ARG_LINK})
  if(EXISTS ${CMAKE_CURRENT_SOURCE_DIR}/include)
    install(DIRECTORY include/ DESTINATION ${CATKIN_GLOBAL_INCLUDE_DESTINATION})
  endif()
  install(TARGETS ${target} ARCHIVE DESTINATION ${CATKIN_PACKAGE_LIB_DESTINATION}
    LIBRARY DESTINATION ${CATKIN_PACKAGE_LIB_DESTINATION})
endfunction()

# air_ground_executable(NAME <name> SOURCES <files> [LINK <targets>])
# An executable found by `rosrun air_ground <name>`; the target is air_ground_<name>_exe. Links the ROS helpers.
function(air_ground_executable)
  cmake_parse_arguments(ARG "" "NAME" "SOURCES;LINK" ${ARGN})
  set(target air_ground_${ARG_NAME}_exe)
  add_executable(${target} ${ARG_SOURCES})
  air_ground_precompile(${target} ros)
  set_target_properties(${target} PROPERTIES OUTPUT_NAME ${ARG_NAME}
    RUNTIME_OUTPUT_DIRECTORY ${CATKIN_DEVEL_PREFIX}/${CATKIN_PACKAGE_BIN_DESTINATION})
  target_link_libraries(${target} PRIVATE ${ARG_LINK} air_ground_common_ros)
  add_dependencies(${target} ${air_ground_EXPORTED_TARGETS})
  install(TARGETS ${target} RUNTIME DESTINATION ${CATKIN_PACKAGE_BIN_DESTINATION})
endfunction()

# How a test starts that leaves the processor to the rostest beside it.
set(air_ground_behind nice -n 10)

# air_ground_gtest(NAME <name> SOURCES <files> [LINK <targets>] [TIMEOUT s] [COST s])
# A plain gtest, no roscore. Run by `make test` through ctest, several at a time, with what the rostest beside them leaves of the
# processor; COST, about the seconds it takes, starts long ones first.
function(air_ground_gtest)
  if(NOT CATKIN_ENABLE_TESTING)
    return()
  endif()
  cmake_parse_arguments(ARG "" "NAME;TIMEOUT;COST" "SOURCES;LINK" ${ARGN})
  set(target air_ground_${ARG_NAME})
  add_executable(${target} ${ARG_SOURCES})
  air_ground_precompile(${target} test)
  target_link_libraries(${target} PRIVATE ${ARG_LINK} GTest::gtest GTest::gtest_main)
  # Each gets a limit so that a hang is a failure.
  if(NOT ARG_TIMEOUT)
    set(ARG_TIMEOUT 900)
  endif()
  if(NOT ARG_COST)
    set(ARG_COST 1)
  endif()
  math(EXPR ARG_TIMEOUT "${air_ground_slower} * ${ARG_TIMEOUT}")
  add_test(NAME ${ARG_NAME} COMMAND ${air_ground_behind} $<TARGET_FILE:${target}>)
  # Threads that wait for each other must not spin: another test runs beside.
  set_tests_properties(${ARG_NAME} PROPERTIES TIMEOUT ${ARG_TIMEOUT} COST ${ARG_COST} ENVIRONMENT OMP_WAIT_POLICY=passive)
endfunction()

# air_ground_rostest(<file.test> [TIMEOUT s] [ALONE | WITHOUT_NODES])
# Runs a rostest file through ctest, with /usr/bin/python3 first on PATH. Each runs its own master on a port of its own.
# Nodes keep pace with a clock: only one rostest runs at a time, beside plain gtests, and one that is ALONE beside nothing.
# One that starts none (WITHOUT_NODES) runs as a plain gtest does.
function(air_ground_rostest FILE)
  if(NOT CATKIN_ENABLE_TESTING)
    return()
  endif()
  cmake_parse_arguments(ARG "ALONE;WITHOUT_NODES" "TIMEOUT" "" ${ARGN})
  if(NOT ARG_TIMEOUT)
    set(ARG_TIMEOUT 900)
  endif()
  math(EXPR ARG_TIMEOUT "${air_ground_slower} * ${ARG_TIMEOUT}")
  set(environment AIR_GROUND_SLOWER=${air_ground_slower})  # see time-limit in the .test files
  get_filename_component(name ${FILE} NAME_WE)
  set(run ${PROJECT_SOURCE_DIR}/tools/run_rostest ${CATKIN_DEVEL_PREFIX} ${CMAKE_CURRENT_SOURCE_DIR}/${FILE} ${CMAKE_BINARY_DIR}/ros_home)
  if(ARG_WITHOUT_NODES)
    add_test(NAME rostest_${name} COMMAND ${air_ground_behind} ${run})
  else()
    add_test(NAME rostest_${name} COMMAND ${run})
    set_tests_properties(rostest_${name} PROPERTIES RESOURCE_LOCK nodes)
  endif()
  set_tests_properties(rostest_${name} PROPERTIES TIMEOUT ${ARG_TIMEOUT} LABELS rostest)
  if(ARG_ALONE)
    set_tests_properties(rostest_${name} PROPERTIES RUN_SERIAL TRUE)
  else()
    list(APPEND environment OMP_WAIT_POLICY=passive)
    set_tests_properties(rostest_${name} PROPERTIES COST 100)
  endif()
  set_tests_properties(rostest_${name} PROPERTIES ENVIRONMENT "${environment}")
endfunction()

# air_ground_ros_gtest(NAME <name> SOURCES <files> [LINK <targets>])
# A gtest that talks to nodes: started from a .test file as <test pkg="air_ground" type="<name>" ...>.
function(air_ground_ros_gtest)
  if(NOT CATKIN_ENABLE_TESTING)
    return()
  endif()
  cmake_parse_arguments(ARG "" "NAME" "SOURCES;LINK" ${ARGN})
  set(target air_ground_${ARG_NAME})
  add_executable(${target} ${ARG_SOURCES})
  air_ground_precompile(${target} ros)
  set_target_properties(${target} PROPERTIES OUTPUT_NAME ${ARG_NAME}
    RUNTIME_OUTPUT_DIRECTORY ${CATKIN_DEVEL_PREFIX}/${CATKIN_PACKAGE_BIN_DESTINATION})
  target_link_libraries(${target} PRIVATE ${ARG_LINK} air_ground_common_ros GTest::gtest)
  add_dependencies(${target} ${air_ground_EXPORTED_TARGETS})
endfunction()

# air_ground_bench(NAME <name> SOURCES <files> [LINK <targets>])
# A Google Benchmark program, built with -DAIR_GROUND_BENCHMARKS=ON into <build>/bench/, run by `make bench`; each of its benchmarks
# once, at the smallest size, by `make test`, so that none can rot.
function(air_ground_bench)
  if(NOT AIR_GROUND_BENCHMARKS)
    return()
  endif()
  cmake_parse_arguments(ARG "" "NAME" "SOURCES;LINK" ${ARGN})
  set(target air_ground_${ARG_NAME})
  add_executable(${target} ${ARG_SOURCES})
  air_ground_precompile(${target} plain)
  set_target_properties(${target} PROPERTIES OUTPUT_NAME ${ARG_NAME} RUNTIME_OUTPUT_DIRECTORY ${CMAKE_BINARY_DIR}/bench)
  target_link_libraries(${target} PRIVATE ${ARG_LINK} benchmark::benchmark benchmark::benchmark_main)
  if(CATKIN_ENABLE_TESTING)
    add_test(NAME ${ARG_NAME}_once COMMAND ${air_ground_behind} ${PROJECT_SOURCE_DIR}/tools/run_benchmark_once $<TARGET_FILE:${target}>)
    set_tests_properties(${ARG_NAME}_once PROPERTIES TIMEOUT 600 LABELS benchmark COST 20 ENVIRONMENT OMP_WAIT_POLICY=passive)
  endif()
endfunction()

# air_ground_script(<file>): a Python program for `rosrun air_ground`, run by the distribution's Python.
function(air_ground_script FILE)
  catkin_install_python(PROGRAMS ${FILE} DESTINATION ${CATKIN_PACKAGE_BIN_DESTINATION})
endfunction()
