// Both ends of a channel within one process: two threads talk through two queues, with the errors and deadlines of TCP.
#pragma once
#include <memory>
#include <utility>

#include "protocol/channel.hpp"

namespace lockstep::protocol {

std::pair<std::unique_ptr<Channel>, std::unique_ptr<Channel>> make_loopback();

}  // namespace lockstep::protocol
