#include "air_ground_common/parameters.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <sstream>

#include "air_ground_common/text.h"

namespace air_ground_common {
namespace {

/// The shortest text that reads back as the same number.
std::string shortest(double value) {
  for (int digits = 15; digits < 17; ++digits)
    if (const std::string text = formatted("%.*g", digits, value); std::strtod(text.c_str(), nullptr) == value)
      return text;
  return formatted("%.17g", value);
}

/// A number that YAML takes for one with a fraction.
std::string yamlOf(double value) {
  std::string text = shortest(value);
  if (text.find('.') != std::string::npos) return text;
  const auto exponent = text.find('e');
  return exponent == std::string::npos ? text + ".0" : text.insert(exponent, ".0");
}

std::string yamlOf(int value) { return std::to_string(value); }
std::string yamlOf(bool value) { return value ? "true" : "false"; }
std::string yamlOf(const std::string& value) { return value.empty() ? "\"\"" : value; }

std::string yamlOf(const std::vector<double>& values) {
  std::string list;
  for (const double value : values) list += (list.empty() ? "" : ", ") + shortest(value);
  return "[" + list + "]";
}

bool isBounded(const ParameterRange& range) { return std::isfinite(range.min) && std::isfinite(range.max); }

std::string joined(const std::vector<std::string>& words) {
  std::string list;
  for (const auto& word : words) list += (list.empty() ? "" : ", ") + word;
  return list;
}

/// Of a bound, which may be pi.
std::string rounded(double value) { return formatted("%.10g", value); }

/// "text [unit] (min..max)".
std::string commentOf(const Parameter& p) {
  std::string comment = p.text;
  if (!p.unit.empty()) comment += " [" + p.unit + "]";
  if (isBounded(p.range)) comment += " (" + rounded(p.range.min) + ".." + rounded(p.range.max) + ")";
  if (!p.choices.empty()) comment += " (" + joined(p.choices) + ")";
  return comment.front() == ' ' ? comment.substr(1) : comment;
}

/// `text` after `first`, in lines of at most 120 columns, the others after `next`.
std::string wrapped(const std::string& first, const std::string& next, const std::string& text) {
  std::string out, line = first;
  std::istringstream words(text);
  for (std::string word; words >> word; line += word + " ") {
    if (line.size() + word.size() <= 120) continue;
    out += line.substr(0, line.size() - 1) + "\n";
    line = next;
  }
  return out + line.substr(0, line.size() - 1) + "\n";
}

}  // namespace

std::string toString(const ParameterField& field) {
  return std::visit([](const auto* value) { return yamlOf(*value); }, field);
}

void ParameterVisitor::visitAndCheck(const Parameter& p, ParameterField field) {
  const std::size_t size =
      std::holds_alternative<std::vector<double>*>(field) ? std::get<std::vector<double>*>(field)->size() : 0;
  visit(p, field);
  std::string rule;
  const auto inRange = [&](double value) {
    return value >= p.range.min && value <= p.range.max && std::isfinite(value);
  };
  const std::string range = !isBounded(p.range) ? std::string()
                                                : " in [" + rounded(p.range.min) + ", " + rounded(p.range.max) + "]" +
                                                      (p.unit.empty() ? "" : " " + p.unit);
  if (const auto* number = std::get_if<double*>(&field)) {
    if (!inRange(**number)) rule = "must lie" + range;
  } else if (const auto* integer = std::get_if<int*>(&field)) {
    if (!inRange(**integer)) rule = "must lie" + range;
  } else if (const auto* text = std::get_if<std::string*>(&field)) {
    if (!p.choices.empty() && std::find(p.choices.begin(), p.choices.end(), **text) == p.choices.end())
      rule = "must be one of: " + joined(p.choices);
  } else if (const auto* list = std::get_if<std::vector<double>*>(&field)) {
    if ((*list)->size() != size || !std::all_of((*list)->begin(), (*list)->end(), inRange))
      rule = "must hold " + std::to_string(size) + " numbers" + range;
  }
  if (!rule.empty()) throw ParameterError("parameter " + fullName(p.name) + " = " + toString(field) + " " + rule);
}

void ParameterVisitor::operator()(const std::string& name, double& field, ParameterRange range, const char* unit,
                                  const char* text) {
  visitAndCheck({name, range, unit, text, {}}, &field);
}

void ParameterVisitor::operator()(const std::string& name, int& field, ParameterRange range, const char* unit,
                                  const char* text) {
  visitAndCheck({name, range, unit, text, {}}, &field);
}

void ParameterVisitor::operator()(const std::string& name, bool& field, const char* text) {
  visitAndCheck({name, {}, "", text, {}}, &field);
}

void ParameterVisitor::operator()(const std::string& name, std::string& field, const char* text,
                                  const std::vector<std::string>& choices) {
  visitAndCheck({name, {}, "", text, choices}, &field);
}

void ParameterVisitor::operator()(const std::string& name, std::vector<double>& field, ParameterRange range,
                                  const char* unit, const char* text) {
  visitAndCheck({name, range, unit, text, {}}, &field);
}

void ParameterVisitor::operator()(const std::string& name, std::optional<Pose>& field, const char* text) {
  std::vector<double> v(7, 0.0);
  if (field) {
    const Eigen::Quaterniond q(field->linear());
    const Eigen::Vector3d t = field->translation();
    v = {t.x(), t.y(), t.z(), q.x(), q.y(), q.z(), q.w()};
  }
  (*this)(name, v, {}, "", text);
  field.reset();
  if (std::all_of(v.begin(), v.end(), [](double x) { return x == 0; })) return;
  const Eigen::Quaterniond q(v[6], v[3], v[4], v[5]);
  if (std::abs(q.norm() - 1) > 1e-2)
    throw ParameterError("parameter " + fullName(name) + " = " + yamlOf(v) +
                         ": the quaternion (last four numbers) must have length 1");
  field = Pose::Identity();
  field->linear() = q.normalized().toRotationMatrix();
  field->translation() = Eigen::Vector3d(v[0], v[1], v[2]);
}

void ParameterVisitor::degrees(const std::string& name, double& field, ParameterRange range, const char* text) {
  double value = std::round(field * (180 / M_PI) * 1e9) / 1e9;  // without the last digits of the conversion
  (*this)(name, value, range, "deg", text);
  field = value * (M_PI / 180);
}

void ParameterWriter::about(const std::string& text) {
  out_ += wrapped("# ", "# ", text) +
          wrapped("# ", "# ",
                  "Written by tools/write_parameters from what the node declares, with defaults, [unit] and (range). A "
                  "misspelt name, or a value out of range, ends the node at start with a line that says so.");
}

void ParameterWriter::section(const std::string& title, const std::string& text) {
  flush();
  out_ += "\n# ---- " + title + " ----\n";
  if (!text.empty()) out_ += wrapped("# ", "# ", text);
}

void ParameterWriter::visit(const Parameter& p, ParameterField field) {
  const auto slash = p.name.find('/');
  const std::string group = slash == std::string::npos ? "" : p.name.substr(0, slash);
  if (group != group_ && !group.empty()) {
    if (!groups_.insert(group).second) throw std::logic_error("the group " + group + " is not declared in one place");
    lines_.emplace_back(group + ":", "");
  }
  group_ = group;
  lines_.emplace_back((group.empty() ? "" : "  ") + p.name.substr(slash + 1) + ": " + toString(field), commentOf(p));
}

void ParameterWriter::flush() {
  std::size_t column = 0;
  for (const auto& line : lines_) column = std::max(column, line.first.size());
  for (const auto& [value, comment] : lines_) {
    const std::string gap(column - value.size() + 1, ' ');
    out_ += comment.empty() ? value + "\n" : wrapped(value + gap + "# ", std::string(column + 1, ' ') + "# ", comment);
  }
  lines_.clear();
  group_.clear();
}

std::string ParameterWriter::written() {
  flush();
  return out_;
}

bool ParameterReader::isKnown(const std::string& given) const {
  if (known_.count(given)) return true;
  for (auto slash = given.find('/'); slash != std::string::npos; slash = given.find('/', slash + 1))
    if (known_.count(given.substr(0, slash))) return true;
  return false;
}

}  // namespace air_ground_common
