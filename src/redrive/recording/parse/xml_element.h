// SPDX-License-Identifier: Apache-2.0
// XML with its file and path, so that every error names file, element and value.
#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include <pugixml.hpp>

namespace redrive {

/// A view into a document, which must outlive it. Every InputError names the element.
class XmlElement {
 public:
  XmlElement(pugi::xml_node node, const std::filesystem::path& file, std::string name)
      : node_(node), file_(&file), name_(std::move(name)) {}

  bool has(const char* name) const { return bool(node_.child(name)); }
  XmlElement child(const char* name) const;  ///< InputError if there is none
  std::vector<XmlElement> children(const char* name) const;
  std::vector<XmlElement> children() const;  ///< all elements
  std::string text() const { return node_.text().get(); }
  double number(double least, double most) const;
  std::int64_t integer(std::int64_t least, std::int64_t most) const;
  /// Numbers of a matrix as OpenCV writes it: rows, cols and data, row by row. InputError unless it
  /// has `cols` columns and 1 to `most_rows` rows of finite numbers.
  std::vector<double> matrix(std::size_t cols, std::size_t most_rows) const;
  [[noreturn]] void fail(const std::string& rule) const;
  const std::string& name() const { return name_; }

 private:
  pugi::xml_node node_;
  const std::filesystem::path* file_;
  std::string name_;
};

class XmlDocument {
 public:
  /// InputError if the text is no XML. `file` must outlive the document.
  XmlDocument(std::string_view text, const std::filesystem::path& file);
  XmlElement root(const char* name) const;  ///< InputError if there is none

 private:
  pugi::xml_document document_;
  const std::filesystem::path* file_;
};

}  // namespace redrive
