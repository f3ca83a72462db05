// Runtime of an exported policy in C++17, without ORBIT: measured numbers in, joint targets out.
//
// Written by `orbit export POLICY --runtime FOLDER` next to policy.onnx and orbit_policy.hpp, its numbers:
//
//   #define ORBIT_WITH_ONNXRUNTIME   // or bring a Network of your own
//   #include "orbit_policy.hpp"
//
//   orbit::OnnxNetwork network("policy.onnx");
//   orbit::Runtime policy(orbit::description(), network);
//   while (true) {                   // every policy.period() seconds
//     const std::vector<float>& targets = policy.step(measured, positions);
//   }
//
// After the constructor no step allocates memory, so that it may run in a real-time loop.

#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#ifdef ORBIT_WITH_ONNXRUNTIME
#include <onnxruntime_cxx_api.h>
#endif

namespace orbit {

/// One term of the observation: scale * (measured - offset), over `history` steps, the oldest first.
struct ObservationTerm {
  std::string name;
  std::string formula;  ///< Quantity that is measured.
  std::string unit;
  std::string frame;
  std::vector<std::string> components;  ///< Names of the numbers, in their order.
  std::vector<float> offset;            ///< One number per component, in `unit`.
  float scale = 1.0f;
  std::size_t history = 1;
  bool last_action = false;  ///< True if the runtime knows the numbers itself.
};

enum class ActionKind { joint_position, binary_gripper, ik_relative };

/// Origin that a command of joint positions is added to: home, the measured position, or the last target.
enum class CommandMode { absolute, relative, integrated };

/// One term of the action. Fields that a kind does not use are empty.
struct ActionTerm {
  std::string name;
  ActionKind kind = ActionKind::joint_position;
  std::vector<std::string> joints;
  std::size_t commands = 0;  ///< Numbers of the action that belong to this term.
  std::vector<float> lower;  ///< Limits of the targets, rad or m.
  std::vector<float> upper;
  CommandMode mode = CommandMode::absolute;
  std::vector<float> home;   ///< rad or m
  std::vector<float> above;  ///< Span of a command of +1, rad or m.
  std::vector<float> below;  ///< Span of a command of -1, rad or m.
  std::vector<float> lead;   ///< Greatest distance of a target from the measured position; empty if unlimited.
  std::vector<float> open;   ///< Targets of a gripper, rad or m.
  std::vector<float> closed;
  std::string frame;  ///< Link of the Jacobian.
  float position_scale = 0.0f;
  float rotation_scale = 0.0f;
  float damping = 0.0f;
  float max_joint_step = 0.0f;  ///< rad
};

/// Numbers of one exported policy.
struct Description {
  std::string task;
  std::string robot;
  double step_dt = 0.0;  ///< Seconds between two steps.
  std::vector<ObservationTerm> observations;
  std::vector<ActionTerm> actions;
};

/// Function from the observation to the action, such as a session of onnxruntime.
class Network {
 public:
  virtual ~Network() = default;

  /// Compute the action from the observation; both have their final size already.
  virtual void run(const std::vector<float>& observation, std::vector<float>& action) = 0;
};

/// Observation builder, action decoder and state of one policy.
class Runtime {
 public:
  /// @throws std::invalid_argument if the description has no rate.
  Runtime(Description description, Network& network) : description_(std::move(description)), network_(network) {
    if (!(description_.step_dt > 0.0)) throw std::invalid_argument("a policy's step_dt must be positive");
    std::size_t observed = 0;
    for (const ObservationTerm& term : description_.observations) {
      begins_.push_back(observed);
      observed += term.components.size() * term.history;
    }
    std::size_t commands = 0, most = 0;
    for (const ActionTerm& term : description_.actions) {
      commands += term.commands;
      most = std::max(most, term.joints.size());
      std::vector<std::size_t> places;
      for (const std::string& joint : term.joints) places.push_back(place_of(joint));
      places_.push_back(std::move(places));
      last_targets_.emplace_back(term.joints.size());
    }
    observation_.resize(observed);
    action_.resize(commands);
    targets_.resize(joints_.size());
    step_.resize(most);
    reset();
  }

  /// Begin an episode: the first observation stands for those before it, and nothing was asked for yet.
  void reset() {
    first_ = true;
    std::fill(action_.begin(), action_.end(), 0.0f);
    has_targets_.assign(description_.actions.size(), false);
  }

  const Description& description() const { return description_; }

  /// Names of the joints, the order of positions and targets.
  const std::vector<std::string>& joints() const { return joints_; }

  /// Seconds between two steps.
  double period() const { return description_.step_dt; }

  /// Action of the last step, in [-1, 1].
  const std::vector<float>& action() const { return action_; }

  /// Return position targets, rad or m, in the order of joints().
  ///
  /// @param measured numbers of each observation term, in the order of the description; those of the last action are
  ///   ignored and may be empty.
  /// @param positions measured position of each joint, rad or m, in the order of joints().
  /// @param jacobians for each action term of kind ik_relative the Jacobian (6, k) of its frame and joints, row by row:
  ///   linear rows, then angular, world axes; empty for others.
  /// @throws std::invalid_argument if sizes do not fit.
  const std::vector<float>& step(const std::vector<std::vector<float>>& measured, const std::vector<float>& positions,
                                 const std::vector<std::vector<float>>& jacobians = {}) {
    network_.run(observe(measured), action_);
    for (float& value : action_) value = clamp(value, -1.0f, 1.0f);
    return decode(action_, positions, jacobians);
  }

  /// Return the observation: scaled, offsets subtracted, with its history, the oldest step first.
  const std::vector<float>& observe(const std::vector<std::vector<float>>& measured) {
    if (measured.size() != description_.observations.size())
      throw std::invalid_argument("there are " + std::to_string(description_.observations.size()) +
                                  " observation terms, and numbers of " + std::to_string(measured.size()));
    for (std::size_t index = 0; index < measured.size(); ++index) {
      const ObservationTerm& term = description_.observations[index];
      const std::vector<float>& numbers = term.last_action ? action_ : measured[index];
      const std::size_t size = term.components.size();
      if (numbers.size() != size)
        throw std::invalid_argument("observation term '" + term.name + "' has " + std::to_string(size) +
                                    " numbers, not " + std::to_string(numbers.size()));
      const auto begin = observation_.begin() + static_cast<std::ptrdiff_t>(begins_[index]);
      const auto end = begin + static_cast<std::ptrdiff_t>(size * term.history);
      const auto newest = end - static_cast<std::ptrdiff_t>(size);
      if (!first_) std::copy(begin + static_cast<std::ptrdiff_t>(size), end, begin);
      for (std::size_t i = 0; i < size; ++i)
        newest[static_cast<std::ptrdiff_t>(i)] = term.scale * (numbers[i] - term.offset[i]);
      if (first_)
        for (auto older = begin; older != newest; older += static_cast<std::ptrdiff_t>(size))
          std::copy(newest, end, older);
    }
    first_ = false;
    return observation_;
  }

  /// Return the position targets of an action, as step() does.
  const std::vector<float>& decode(const std::vector<float>& action, const std::vector<float>& positions,
                                   const std::vector<std::vector<float>>& jacobians = {}) {
    if (positions.size() != joints_.size())
      throw std::invalid_argument("there are " + std::to_string(joints_.size()) + " joints, and positions of " +
                                  std::to_string(positions.size()));
    std::size_t begin = 0;
    for (std::size_t index = 0; index < description_.actions.size(); ++index) {
      const ActionTerm& term = description_.actions[index];
      const float* command = action.data() + begin;
      begin += term.commands;
      if (term.kind == ActionKind::joint_position)
        joint_position(index, command, positions);
      else if (term.kind == ActionKind::binary_gripper)
        for (std::size_t i = 0; i < term.joints.size(); ++i)
          targets_[places_[index][i]] = command[0] < 0.0f ? term.closed[i] : term.open[i];
      else
        ik_relative(index, command, positions, jacobians);
    }
    return targets_;
  }

 private:
  static float clamp(float value, float lower, float upper) { return std::min(std::max(value, lower), upper); }

  std::size_t place_of(const std::string& joint) {
    const auto found = std::find(joints_.begin(), joints_.end(), joint);
    if (found == joints_.end()) joints_.push_back(joint);
    return static_cast<std::size_t>(std::find(joints_.begin(), joints_.end(), joint) - joints_.begin());
  }

  void joint_position(std::size_t index, const float* command, const std::vector<float>& positions) {
    const ActionTerm& term = description_.actions[index];
    for (std::size_t i = 0; i < term.joints.size(); ++i) {
      const std::size_t place = places_[index][i];
      const float here = positions[place];
      const bool continued = term.mode == CommandMode::integrated && has_targets_[index];
      const float origin = term.mode == CommandMode::absolute ? term.home[i] : continued ? last_targets_[index][i] : here;
      float target = origin + command[i] * (command[i] < 0.0f ? term.below[i] : term.above[i]);
      if (!term.lead.empty()) target = clamp(target, here - term.lead[i], here + term.lead[i]);
      // Limits last: a lead must not carry a target beyond them.
      last_targets_[index][i] = targets_[place] = clamp(target, term.lower[i], term.upper[i]);
    }
    has_targets_[index] = true;
  }

  /// One step of damped least squares towards a displaced hand, J^T (J J^T + lambda^2 I)^-1 e.
  void ik_relative(std::size_t index, const float* command, const std::vector<float>& positions,
                   const std::vector<std::vector<float>>& jacobians) {
    const ActionTerm& term = description_.actions[index];
    const std::size_t joints = term.joints.size();
    if (index >= jacobians.size() || jacobians[index].size() != 6 * joints)
      throw std::invalid_argument("action term '" + term.name + "' needs the Jacobian (6, " + std::to_string(joints) +
                                  ") of '" + term.frame + "'");
    const float* jacobian = jacobians[index].data();
    std::array<double, 36> square{};
    std::array<double, 6> error{};
    for (std::size_t row = 0; row < 6; ++row) {
      error[row] = static_cast<double>(command[row]) * (row < 3 ? term.position_scale : term.rotation_scale);
      for (std::size_t column = 0; column <= row; ++column) {
        double sum = row == column ? static_cast<double>(term.damping) * term.damping : 0.0;
        for (std::size_t j = 0; j < joints; ++j)
          sum += static_cast<double>(jacobian[row * joints + j]) * jacobian[column * joints + j];
        square[row * 6 + column] = sum;
      }
    }
    solve(square, error);
    float longest = 1e-12f;
    for (std::size_t j = 0; j < joints; ++j) {
      double sum = 0.0;
      for (std::size_t row = 0; row < 6; ++row) sum += jacobian[row * joints + j] * error[row];
      step_[j] = static_cast<float>(sum);
      longest = std::max(longest, std::fabs(step_[j]));
    }
    // Shortened as a whole, so that the hand keeps its direction.
    const float share = std::min(1.0f, term.max_joint_step / longest);
    for (std::size_t j = 0; j < joints; ++j) {
      const std::size_t place = places_[index][j];
      targets_[place] = clamp(positions[place] + share * step_[j], term.lower[j], term.upper[j]);
    }
  }

  /// Solve a positive definite system by Cholesky's decomposition; the lower triangle is overwritten.
  static void solve(std::array<double, 36>& square, std::array<double, 6>& right) {
    for (std::size_t row = 0; row < 6; ++row) {
      for (std::size_t column = 0; column <= row; ++column) {
        double sum = square[row * 6 + column];
        for (std::size_t k = 0; k < column; ++k) sum -= square[row * 6 + k] * square[column * 6 + k];
        square[row * 6 + column] = row == column ? std::sqrt(sum) : sum / square[column * 6 + column];
      }
      for (std::size_t k = 0; k < row; ++k) right[row] -= square[row * 6 + k] * right[k];
      right[row] /= square[row * 6 + row];
    }
    for (std::size_t row = 6; row-- > 0;) {
      for (std::size_t k = row + 1; k < 6; ++k) right[row] -= square[k * 6 + row] * right[k];
      right[row] /= square[row * 6 + row];
    }
  }

  Description description_;
  Network& network_;
  std::vector<std::string> joints_;
  std::vector<std::size_t> begins_;               // of each term in the observation
  std::vector<std::vector<std::size_t>> places_;  // of each action term's joints in joints_
  std::vector<std::vector<float>> last_targets_;
  std::vector<bool> has_targets_;
  std::vector<float> observation_, action_, targets_, step_;
  bool first_ = true;
};

#ifdef ORBIT_WITH_ONNXRUNTIME
/// Session of onnxruntime on one thread of the CPU.
class OnnxNetwork : public Network {
 public:
  /// @param file path of policy.onnx.
  explicit OnnxNetwork(const char* file) : session_(environment_, file, options()) {}

  void run(const std::vector<float>& observation, std::vector<float>& action) override {
    const std::array<std::int64_t, 2> in{1, static_cast<std::int64_t>(observation.size())};
    const std::array<std::int64_t, 2> out{1, static_cast<std::int64_t>(action.size())};
    // The tensors are views of the vectors, so that nothing is copied.
    const Ort::Value input = Ort::Value::CreateTensor<float>(memory_, const_cast<float*>(observation.data()),
                                                             observation.size(), in.data(), in.size());
    Ort::Value output = Ort::Value::CreateTensor<float>(memory_, action.data(), action.size(), out.data(), out.size());
    const char* names_in[] = {"observation"};
    const char* names_out[] = {"action"};
    session_.Run(Ort::RunOptions{nullptr}, names_in, &input, 1, names_out, &output, 1);
  }

 private:
  static Ort::SessionOptions options() {
    Ort::SessionOptions options;
    options.SetIntraOpNumThreads(1);
    return options;
  }

  Ort::Env environment_{ORT_LOGGING_LEVEL_WARNING, "orbit"};
  Ort::MemoryInfo memory_ = Ort::MemoryInfo::CreateCpu(OrtArenaAllocator, OrtMemTypeDefault);
  Ort::Session session_;
};
#endif

}  // namespace orbit
