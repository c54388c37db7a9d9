// Plain structs to frames and back. The generated protobuf classes are seen by codec.cpp alone.
//
// Every message is checked in both directions: all doubles finite, array lengths consistent with each other and with
// the interface mesh, facets made of nodes that exist, enums in range, time_step above zero. What the peer got wrong is
// a PeerError; what this side was about to send is a NumericalError (not finite) or an InternalError. The words name
// message, field, position and value.
//
// Velocities and Forces keep the generated objects and the caller's buffers: no memory is taken after the first call.
#pragma once
#include <cstddef>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "protocol/messages.hpp"

namespace lockstep::protocol {

class Codec {
 public:
  Codec();
  ~Codec();

  // From here on arrays per node and per facet must have these lengths. Known from InitialStress on.
  void set_mesh(std::size_t nodes, std::size_t facets);

  // Makes a whole frame, header included, in `frame`, whose memory is reused.
  void encode(const Message& message, std::vector<std::byte>& frame);
  void encode(const Velocities& message, std::vector<std::byte>& frame);
  void encode(const Forces& message, std::vector<std::byte>& frame);

  // Takes a whole frame whose header and checksum have been checked. The typed ones need a frame of that type.
  Message decode(std::span<const std::byte> frame);
  void decode(std::span<const std::byte> frame, Velocities& into);
  void decode(std::span<const std::byte> frame, Forces& into);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

// The first field in which two frames of one type differ, "velocity[7]: 0.5 -> 0.25"; empty if they say the same.
std::string first_difference(std::span<const std::byte> a, std::span<const std::byte> b);

}  // namespace lockstep::protocol
