// Tables of named stages: one entry holds the declaration and the constructor.
#pragma once

#include <yaml-cpp/yaml.h>

#include <functional>
#include <string>
#include <vector>

#include "icp_refine/stage.h"

namespace icp_refine {

template <class Product>
struct StageEntry {
  StageDoc doc;
  std::function<Product(const StageParameters&)> make;
};

template <class Product>
std::vector<StageDoc> docsOf(const std::vector<StageEntry<Product>>& table) {
  std::vector<StageDoc> docs;
  for (const auto& entry : table) docs.push_back(entry.doc);
  return docs;
}

template <class Product>
Product makeFrom(const std::vector<StageEntry<Product>>& table, const std::string& kind, const std::string& name,
                 const YAML::Node& parameters) {
  std::string known;
  for (const auto& entry : table) {
    if (entry.doc.name == name) return entry.make(StageParameters(entry.doc, parameters));
    known += (known.empty() ? "" : ", ") + entry.doc.name;
  }
  throw ConfigError("unknown " + kind + " '" + name + "'; known: " + known);
}

}  // namespace icp_refine
