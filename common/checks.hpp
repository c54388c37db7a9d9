// Failures by kind. CHECK-like errors mean that the user or the peer is wrong: the text names file, key, value, range
// and remedy. LOCKSTEP_ASSERT means that we are wrong. The process exits with the code of the kind.
#pragma once
#include <spdlog/fmt/fmt.h>

#include <stdexcept>
#include <string>

namespace lockstep {

enum class ExitCode : int { Success = 0, Input = 1, Io = 2, Peer = 3, Numerical = 4, Internal = 5, Interrupted = 130 };

class Error : public std::runtime_error {
 public:
  Error(ExitCode code, const std::string& text) : std::runtime_error(text), code_(code) {}
  ExitCode code() const { return code_; }

 private:
  ExitCode code_;
};

// The scene, an argument or a file's content is wrong.
struct InputError : Error {
  explicit InputError(const std::string& text) : Error(ExitCode::Input, text) {}
};
// A file, folder or port cannot be opened, read or written.
struct IoError : Error {
  explicit IoError(const std::string& text) : Error(ExitCode::Io, text) {}
};
// The peer is dead, silent, of another version, or speaks out of turn.
struct PeerError : Error {
  explicit PeerError(const std::string& text, ExitCode code = ExitCode::Peer) : Error(code, text) {}
};
// The computation left what is stable or finite, or did not converge.
struct NumericalError : Error {
  explicit NumericalError(const std::string& text) : Error(ExitCode::Numerical, text) {}
};
// The user pressed Ctrl-C, or the peer said that its user did.
struct Interrupted : Error {
  explicit Interrupted(const std::string& text) : Error(ExitCode::Interrupted, text) {}
};
struct InternalError : Error {
  explicit InternalError(const std::string& text) : Error(ExitCode::Internal, text) {}
};

}  // namespace lockstep

#define LOCKSTEP_ASSERT(condition, ...)                                                            \
  do {                                                                                             \
    if (!(condition))                                                                              \
      throw ::lockstep::InternalError(                                                             \
          fmt::format("{}:{}: {}: {}", __FILE__, __LINE__, #condition, fmt::format(__VA_ARGS__))); \
  } while (false)
