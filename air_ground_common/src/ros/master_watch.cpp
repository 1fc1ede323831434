#include "air_ground_common/ros/master_watch.h"

#include <ros/console.h>
#include <ros/init.h>
#include <ros/master.h>
#include <ros/network.h>
#include <ros/this_node.h>
#include <ros/time.h>
#include <ros/xmlrpc_manager.h>
#include <xmlrpcpp/XmlRpcClient.h>

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <map>
#include <mutex>
#include <optional>
#include <set>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

namespace air_ground_common::ros_utils {
namespace {

using std::chrono::seconds;
using XmlRpc::XmlRpcValue;

constexpr seconds kPeriod(1);
constexpr int kLook = 5;         // periods between two looks at what the master has of the node
constexpr seconds kLastCall(2);  // that runs may take so long when the watch ends

template <typename... Words>
XmlRpcValue request(const Words&... words) {
  XmlRpcValue list;
  int i = 0;
  ((list[i++] = words), ...);
  return list;
}

/// What the master answers; empty when it does not, or refuses.
std::optional<XmlRpcValue> ask(const std::string& method, const XmlRpcValue& arguments) {
  XmlRpcValue response, payload;
  if (!ros::master::execute(method, arguments, response, payload, false)) return std::nullopt;
  return payload;
}

/// The same of this node's own slave API.
std::optional<XmlRpcValue> askSelf(const std::string& method, const XmlRpcValue& arguments) {
  std::string host;
  std::uint32_t port = 0;
  if (!ros::network::splitURI(ros::XMLRPCManager::instance()->getServerURI(), host, port)) return std::nullopt;
  XmlRpc::XmlRpcClient client(host.c_str(), static_cast<int>(port), "/");
  XmlRpcValue response;
  if (!client.execute(method.c_str(), arguments, response) || client.isFault() || response.size() < 3)
    return std::nullopt;
  return XmlRpcValue(response[2]);
}

}  // namespace

struct MasterWatch::Impl {
  void run();
  bool wait(std::chrono::milliseconds time) {
    std::unique_lock<std::mutex> lock(mutex);
    changed.wait_for(lock, time, [this] { return stop; });
    return !stop && ros::ok();
  }

  void watch();
  void look();
  bool registerAgain();
  bool registerTopics(const XmlRpcValue& topics, const std::string& method);
  void connect(const std::string& topic, XmlRpcValue publishers);

  std::mutex mutex;
  std::condition_variable changed;
  bool stop = false, over = false;

  // The thread's own.
  const std::string name = ros::this_node::getName();
  int master = -1;  ///< its process
  int until_look = 0;
  bool registering = false;                     ///< begun and not finished
  std::map<std::string, std::string> services;  ///< name to URI
  XmlRpcValue parameters;                       ///< private ones
};

void MasterWatch::Impl::run() {
  while (wait(kPeriod)) {
    try {
      watch();
    } catch (const std::exception& e) {
      ROS_WARN_STREAM_ONCE("what answers at ROS_MASTER_URI is no ROS master, or one that fails: " << e.what());
    } catch (const XmlRpc::XmlRpcException& e) {
      ROS_WARN_STREAM_ONCE("what answers at ROS_MASTER_URI is no ROS master, or one that fails: " << e.getMessage());
    }
  }
  const std::lock_guard<std::mutex> lock(mutex);
  over = true;
  changed.notify_all();
}

void MasterWatch::Impl::watch() {
  const auto pid = ask("getPid", request(name));
  if (!pid) {
    until_look = 0;
    return;
  }
  const bool another = master != static_cast<int>(XmlRpcValue(*pid));
  if (!another && !registering && until_look-- > 0) return;
  until_look = kLook;
  look();
  if (registering && !registerAgain()) return;
  registering = false;
  master = XmlRpcValue(*pid);
}

/// Remembers what the master has of this node, or finds that it has not.
void MasterWatch::Impl::look() {
  auto state = ask("getSystemState", request(name));
  if (!state) throw std::runtime_error("no system state");
  const auto names = [&](XmlRpcValue& listed) {  // that list this node
    std::vector<std::string> result;
    for (int i = 0; i < listed.size(); ++i)
      for (int k = 0; k < listed[i][1].size(); ++k)
        if (std::string(listed[i][1][k]) == name) result.push_back(listed[i][0]);
    return result;
  };
  const auto topics = names((*state)[0]);
  // Every node has this topic; others a new master may have from a subscription that was just made.
  registering = registering || std::find(topics.begin(), topics.end(), "/rosout") == topics.end();
  if (registering) return;
  for (const std::string& service : names((*state)[2])) {
    if (services.count(service) > 0) continue;
    if (auto uri = ask("lookupService", request(name, service))) services[service] = std::string(*uri);
  }
  if (const auto values = ask("getParam", request(name, name))) parameters = *values;
}

bool MasterWatch::Impl::registerAgain() {
  // Publishers first: as long as the master knows no subscriber of a topic it does not make any give up those that have
  // not registered yet.
  const auto publications = askSelf("getPublications", request(name)),
             subscriptions = askSelf("getSubscriptions", request(name));
  if (!publications || !subscriptions || !registerTopics(*publications, "registerPublisher")) return false;
  const std::string own_uri = ros::XMLRPCManager::instance()->getServerURI();
  for (const auto& [service, uri] : services)
    if (!ask("registerService", request(name, service, uri, own_uri))) return false;
  // A node that is respawned later must find what it was configured with.
  if (parameters.valid() && !ask("getParam", request(name, name)) && !ask("setParam", request(name, name, parameters)))
    return false;
  ROS_WARN("the ROS master has been started again: this node registers its topics, services and parameters");
  if (ros::Time::isSimTime() && !ask("getParam", request(name, std::string("/use_sim_time"))))
    ask("setParam", request(name, std::string("/use_sim_time"), true));
  return registerTopics(*subscriptions, "registerSubscriber");
}

bool MasterWatch::Impl::registerTopics(const XmlRpcValue& topics, const std::string& method) {
  XmlRpcValue list = topics;
  for (int i = 0; i < list.size(); ++i) {
    const std::string topic = list[i][0], type = list[i][1];
    const auto others = ask(method, request(name, topic, type, ros::XMLRPCManager::instance()->getServerURI()));
    if (!others) return false;
    if (method == "registerSubscriber") connect(topic, *others);
  }
  return true;
}

/// Connects to publishers that have registered before this node did, and keeps those that it is connected with.
void MasterWatch::Impl::connect(const std::string& topic, XmlRpcValue publishers) {
  std::set<std::string> uris;
  for (int i = 0; i < publishers.size(); ++i) uris.insert(publishers[i]);
  if (uris.empty()) return;
  auto connections = askSelf("getBusInfo", request(name));
  for (int i = 0; connections && i < connections->size(); ++i) {
    XmlRpcValue& c = (*connections)[i];  // number, peer, direction, transport, topic, ...
    if (std::string(c[2]) == "i" && std::string(c[4]) == topic) uris.insert(c[1]);
  }
  XmlRpcValue list;
  list.setSize(0);
  for (const std::string& uri : uris) list[list.size()] = uri;
  askSelf("publisherUpdate", request(name, topic, list));
}

MasterWatch::MasterWatch() : impl_(std::make_shared<Impl>()) {
  std::thread([impl = impl_] { impl->run(); }).detach();
}

MasterWatch::~MasterWatch() {
  std::unique_lock<std::mutex> lock(impl_->mutex);
  impl_->stop = true;
  impl_->changed.notify_all();
  impl_->changed.wait_for(lock, kLastCall, [this] { return impl_->over; });  // it should not outlive roscpp
}

}  // namespace air_ground_common::ros_utils
