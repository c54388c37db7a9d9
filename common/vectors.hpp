// Fixed-size vectors and matrices. Frames and signs: common/README.md.
#pragma once
#include <Eigen/Core>
#include <Eigen/Geometry>
#include <vector>

namespace lockstep {

using Vec3 = Eigen::Vector3d;
using Mat3 = Eigen::Matrix3d;
using Voigt = Eigen::Matrix<double, 6, 1>;  // order xx yy zz xy yz zx, tension positive
using Quat = Eigen::Quaterniond;

// Small fixed-size Eigen types that hold doubles in 16-byte multiples need no special allocator from C++17 on.
using Vec3s = std::vector<Vec3>;

inline constexpr double pi = 3.14159265358979323846;

}  // namespace lockstep
