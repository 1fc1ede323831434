// Parameters of a program, each declared once: `describe(visitor, settings)` beside a settings struct names every field
// that a user may set, with its range, unit and meaning. Visitors read the fields from a ROS parameter server or a YAML
// file, check them, or write the commented YAML file of a node. The default is the field's own.
#pragma once

#include <initializer_list>
#include <limits>
#include <map>
#include <optional>
#include <set>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>
#include <variant>
#include <vector>

#include "air_ground_common/geometry.h"

namespace air_ground_common {

/// Thrown with one line that names the parameter, its value and what is allowed.
class ParameterError : public std::invalid_argument {
 public:
  using std::invalid_argument::invalid_argument;
};

/// What is allowed, ends included.
struct ParameterRange {
  double min = -std::numeric_limits<double>::infinity(), max = std::numeric_limits<double>::infinity();
};

struct Parameter {
  std::string name;  ///< with slashes where it lies in a group
  ParameterRange range;
  std::string unit, text;
  std::vector<std::string> choices;  ///< of a text; empty: any
};

using ParameterField = std::variant<double*, int*, bool*, std::string*, std::vector<double>*>;

/// Every call checks, after the visit, that the field holds what is allowed, else throws ParameterError. A field may be
/// a local variable that is converted before and after the call.
class ParameterVisitor {
 public:
  virtual ~ParameterVisitor() = default;

  /// What the program is, and how its parameters are meant as a whole.
  virtual void about(const std::string&) {}
  /// Heads the parameters that follow.
  virtual void section(const std::string&, const std::string& /*text*/ = "") {}
  /// A name that others read, with what lies below it.
  virtual void others(const std::string&) {}

  void operator()(const std::string& name, double& field, ParameterRange range, const char* unit, const char* text);
  void operator()(const std::string& name, int& field, ParameterRange range, const char* unit, const char* text);
  void operator()(const std::string& name, bool& field, const char* text);
  void operator()(const std::string& name, std::string& field, const char* text,
                  const std::vector<std::string>& choices = {});
  /// As many numbers as the field holds.
  void operator()(const std::string& name, std::vector<double>& field, ParameterRange range, const char* unit,
                  const char* text);
  /// "x y z qx qy qz qw" [m]; seven zeros for none.
  void operator()(const std::string& name, std::optional<Pose>& field, const char* text);
  /// `field` in radians, the parameter in degrees.
  void degrees(const std::string& name, double& field, ParameterRange range, const char* text);

  /// Whole numbers of other types, for ranges that an int holds.
  template <typename Integer, std::enable_if_t<std::is_integral_v<Integer>, int> = 0>
  void operator()(const std::string& name, Integer& field, ParameterRange range, const char* unit, const char* text) {
    int value = static_cast<int>(field);
    (*this)(name, value, range, unit, text);
    field = static_cast<Integer>(value);
  }
  /// A value by its name.
  template <typename Value>
  void choice(const std::string& name, Value& field,
              std::initializer_list<std::pair<const char*, std::common_type_t<Value>>> choices, const char* text) {
    std::vector<std::string> names;
    std::string chosen;
    for (const auto& c : choices) {
      names.push_back(c.first);
      if (c.second == field) chosen = c.first;
    }
    (*this)(name, chosen, text, names);
    for (const auto& c : choices)
      if (chosen == c.first) field = c.second;
  }

 private:
  virtual void visit(const Parameter& parameter, ParameterField field) = 0;
  /// For messages.
  virtual std::string fullName(const std::string& name) const { return name; }
  void check(const Parameter& parameter, ParameterField field) const;
  void visitAndCheck(const Parameter& parameter, ParameterField field);
};

/// As messages show it.
std::string toString(const ParameterField& field);

/// Changes nothing: what remains is the check of the ranges.
class ParameterCheck : public ParameterVisitor {
  void visit(const Parameter&, ParameterField) override {}
};

/// Throws ParameterError for a field out of its range.
template <typename Settings>
void checkRanges(Settings settings) {
  ParameterCheck visitor;
  describe(visitor, settings);
}

class ParameterWriter : public ParameterVisitor {
 public:
  void about(const std::string& text) override;
  void section(const std::string& title, const std::string& text) override;
  std::string written();

 private:
  void visit(const Parameter& parameter, ParameterField field) override;
  void flush();

  std::string out_, group_;
  std::set<std::string> groups_;
  std::vector<std::pair<std::string, std::string>>
      lines_;  ///< value and comment; comments of a section start in one column
};

/// The commented YAML file of all parameters with their values.
template <typename Settings>
std::string yamlFile(Settings settings) {
  ParameterWriter visitor;
  describe(visitor, settings);
  return visitor.written();
}

/// Reads from somewhere, and knows which names were asked for.
class ParameterReader : public ParameterVisitor {
 public:
  void others(const std::string& name) override { known_.insert(name); }

 protected:
  /// `given` has slashes; what lies below a known name is known.
  bool isKnown(const std::string& given) const;
  std::set<std::string> known_;
};

/// Reads a YAML file, nested where names have slashes, and "name=value" of a command line, which counts more. What both
/// lack keeps its value. Throws ParameterError, also for a name that `settings` does not know.
class YamlReader : public ParameterReader {
 public:
  YamlReader(const std::string& path, const std::vector<std::string>& assignments);
  void finish() const;

 private:
  void visit(const Parameter& parameter, ParameterField field) override;

  std::map<std::string, std::string> given_;  ///< by name with slashes, as YAML
};

template <typename Settings>
void readYaml(const std::string& path, const std::vector<std::string>& assignments, Settings* settings) {
  YamlReader visitor(path, assignments);
  describe(visitor, *settings);
  visitor.finish();
}

}  // namespace air_ground_common
