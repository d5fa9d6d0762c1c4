// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/parse/xml_element.h"

#include <algorithm>

#include "redrive/base/error.h"
#include "redrive/recording/parse/text_lines.h"

namespace redrive {
namespace {

constexpr double kMostNumber = 1e12;

TextLine single_word(const XmlElement& element, const std::string& text,
                     const std::filesystem::path& file) {
  TextLine words(text, file, 0);
  if (words.size() != 1) element.fail("a number was expected");
  return words;
}

}  // namespace

XmlElement XmlElement::child(const char* name) const {
  const pugi::xml_node found = node_.child(name);
  if (!found) throw InputError(*file_, name_ + "." + name, "", "missing");
  return {found, *file_, name_ + "." + name};
}

std::vector<XmlElement> XmlElement::children(const char* name) const {
  std::vector<XmlElement> items;
  for (const pugi::xml_node& item : node_.children(name))
    items.emplace_back(item, *file_, name_ + "[" + std::to_string(items.size()) + "]");
  return items;
}

std::vector<XmlElement> XmlElement::children() const {
  std::vector<XmlElement> items;
  for (const pugi::xml_node& item : node_.children())
    if (item.type() == pugi::node_element)
      items.emplace_back(item, *file_, name_ + "." + item.name());
  return items;
}

double XmlElement::number(double least, double most) const {
  const std::string words = text();
  return single_word(*this, words, *file_).number(0, name_, least, most);
}

std::int64_t XmlElement::integer(std::int64_t least, std::int64_t most) const {
  const std::string words = text();
  return single_word(*this, words, *file_).integer(0, name_, least, most);
}

std::vector<double> XmlElement::matrix(std::size_t cols, std::size_t most_rows) const {
  const auto rows =
      static_cast<std::size_t>(child("rows").integer(1, static_cast<std::int64_t>(most_rows)));
  child("cols").integer(static_cast<std::int64_t>(cols), static_cast<std::int64_t>(cols));
  const XmlElement data = child("data");
  std::string words = data.text();
  std::ranges::replace(words, '\n', ' ');
  const TextLine line(words, *file_, 0);
  line.expect_size(rows * cols, data.name() + " of " + std::to_string(rows) + " rows");
  std::vector<double> numbers;
  for (std::size_t i = 0; i < line.size(); ++i)
    numbers.push_back(line.number(i, data.name(), -kMostNumber, kMostNumber));
  return numbers;
}

void XmlElement::fail(const std::string& rule) const {
  throw InputError(*file_, name_, text().substr(0, 80), rule);
}

XmlDocument::XmlDocument(std::string_view text, const std::filesystem::path& file) : file_(&file) {
  if (const pugi::xml_parse_result result = document_.load_buffer(text.data(), text.size());
      !result)
    throw InputError(file, "byte " + std::to_string(result.offset), "",
                     std::string("no XML: ") + result.description());
}

XmlElement XmlDocument::root(const char* name) const {
  const pugi::xml_node node = document_.child(name);
  if (!node) throw InputError(*file_, name, "", "missing: the element that holds all others");
  return {node, *file_, name};
}

}  // namespace redrive
