#include "map_thread.h"

#include <sensor_msgs/PointCloud2.h>

#include <exception>
#include <future>

#include "air_ground_common/niceness.h"

namespace icp_refine {

namespace ros_utils = air_ground_common::ros_utils;

MapThread::MapThread(const AugmentedMapSettings& settings, const std::string& frame, double period,
                     ros_utils::NodeHealth& health)
    : frame_(frame),
      period_(std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(period))),
      health_(health),
      shown_{AugmentedMap(settings), {}} {
  // Without subscribers it stays due.
  publisher_ = ros::NodeHandle().advertise<sensor_msgs::PointCloud2>(
      "augmented_map", 1, [this](const ros::SingleSubscriberPublisher&) { post([](Shown&) {}, false); }, {}, {}, true);
  thread_ = std::thread([this] { work(); });
}

MapThread::~MapThread() {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    stop_ = true;
  }
  wake_.notify_all();
  thread_.join();
}

void MapThread::post(Change change, bool shows) {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    changes_.emplace_back(std::move(change), shows);
  }
  wake_.notify_all();
}

std::pair<std::vector<LabeledPoint>, bool> MapThread::points() {
  std::promise<std::pair<std::vector<LabeledPoint>, bool>> made;
  post(
      [&made](Shown& shown) {
        try {
          made.set_value({shown.map.points(), shown.map.aligned()});
        } catch (const std::exception&) {
          made.set_exception(std::current_exception());
        }
      },
      false);
  return made.get_future().get();
}

void MapThread::work() {
  air_ground_common::giveWayWithin();
  while (true) {
    std::deque<std::pair<Change, bool>> changes;
    {
      std::unique_lock<std::mutex> lock(mutex_);
      const auto changed = [this] { return stop_ || !changes_.empty(); };
      if (publishes())
        wake_.wait_until(lock, next_, changed);
      else
        wake_.wait(lock, changed);
      if (stop_ && changes_.empty()) return;
      std::swap(changes, changes_);
    }
    for (auto& [change, shows] : changes) {
      try {
        const bool before = shown_.map.aligned();
        change(shown_);
        due_ |= shows && (before || shown_.map.aligned());
      } catch (const std::exception& e) {
        health_.count(std::string("changes of the augmented map that failed: ") + e.what());
      }
    }
    publish();
  }
}

void MapThread::publish() {
  if (!publishes() || Clock::now() < next_) return;
  try {
    std_msgs::Header header;
    header.stamp = shown_.stamp;
    header.frame_id = frame_;
    publisher_.publish(ros_utils::toMsg(shown_.map.points(), ros_utils::CloudFields::kXyzRgbSource, header));
  } catch (const std::exception& e) {
    health_.count(std::string("augmented maps that could not be published: ") + e.what());
  }
  due_ = false;
  next_ = Clock::now() + period_;
}

}  // namespace icp_refine
