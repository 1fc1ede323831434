// The only translation unit with PCL in it: its headers dominate build time.
#include <pcl/kdtree/kdtree_flann.h>
#include <pcl/point_types.h>

#include <stdexcept>

#include "icp_refine/cloud.h"

namespace icp_refine {
namespace {

// Presents a point with normal as (x, y, z, w nx, w ny, w nz) to the tree.
class PointAndNormal : public pcl::PointRepresentation<pcl::PointNormal> {
 public:
  explicit PointAndNormal(float weight) : weight_(weight) {
    nr_dimensions_ = 6;
    trivial_ = false;
  }
  void copyToFloatArray(const pcl::PointNormal& p, float* out) const override {
    out[0] = p.x, out[1] = p.y, out[2] = p.z;
    out[3] = weight_ * p.normal_x, out[4] = weight_ * p.normal_y, out[5] = weight_ * p.normal_z;
  }

 private:
  float weight_;
};

pcl::PointNormal pointNormal(const Eigen::Vector3f& p, const Eigen::Vector3f& n) {
  pcl::PointNormal out;
  out.x = p.x(), out.y = p.y(), out.z = p.z();
  out.normal_x = n.x(), out.normal_y = n.y(), out.normal_z = n.z();
  return out;
}

}  // namespace

struct NeighborSearch::Impl {
  float normal_weight = 0;
  pcl::KdTreeFLANN<pcl::PointXYZ> points;
  pcl::KdTreeFLANN<pcl::PointNormal> points_and_normals;
};

NeighborSearch::NeighborSearch(const Cloud& cloud, float normal_weight) : impl_(std::make_unique<Impl>()) {
  if (cloud.empty()) throw std::invalid_argument("NeighborSearch: the cloud is empty");
  impl_->normal_weight = normal_weight;
  if (normal_weight > 0) {
    if (!cloud.hasNormals()) {
      throw std::invalid_argument("NeighborSearch: normal_weight > 0 needs normals; add SurfaceNormals to the filters");
    }
    auto copy = std::make_shared<pcl::PointCloud<pcl::PointNormal>>();
    copy->reserve(cloud.size());
    for (std::size_t i = 0; i < cloud.size(); ++i) copy->push_back(pointNormal(cloud.points[i], cloud.normals[i]));
    impl_->points_and_normals.setPointRepresentation(
        pcl::KdTreeFLANN<pcl::PointNormal>::PointRepresentationConstPtr(new PointAndNormal(normal_weight)));
    impl_->points_and_normals.setInputCloud(copy);
  } else {
    auto copy = std::make_shared<pcl::PointCloud<pcl::PointXYZ>>();
    copy->reserve(cloud.size());
    for (const auto& p : cloud.points) copy->push_back(pcl::PointXYZ(p.x(), p.y(), p.z()));
    impl_->points.setInputCloud(copy);
  }
}

NeighborSearch::~NeighborSearch() = default;
NeighborSearch::NeighborSearch(NeighborSearch&&) noexcept = default;
NeighborSearch& NeighborSearch::operator=(NeighborSearch&&) noexcept = default;

float NeighborSearch::normalWeight() const { return impl_->normal_weight; }

int NeighborSearch::nearest(const Eigen::Vector3f& point, const Eigen::Vector3f& normal, float max_distance) const {
  thread_local std::vector<int> index(1);
  thread_local std::vector<float> squared(1);
  const int found =
      impl_->normal_weight > 0
          ? impl_->points_and_normals.nearestKSearch(pointNormal(point, normal), 1, index, squared)
          : impl_->points.nearestKSearch(pcl::PointXYZ(point.x(), point.y(), point.z()), 1, index, squared);
  return found == 1 && squared[0] <= max_distance * max_distance ? index[0] : -1;
}

void NeighborSearch::nearestK(const Eigen::Vector3f& point, int k, std::vector<int>& indices,
                              std::vector<float>& squared_distances) const {
  if (impl_->normal_weight > 0) throw std::logic_error("NeighborSearch::nearestK: built with normals");
  impl_->points.nearestKSearch(pcl::PointXYZ(point.x(), point.y(), point.z()), k, indices, squared_distances);
}

}  // namespace icp_refine
