#include "colmap_ext/io/npz_file.h"

#include <algorithm>
#include <codecvt>
#include <cstdint>
#include <cstring>
#include <locale>
#include <string_view>

#include <minizip/unzip.h>
#include <minizip/zip.h>

#include "colmap_ext/io/input_file.h"
#include "src/util/errors.h"
#include "src/util/parse_number.h"

namespace mfir {
namespace {

// The header of a .npy file is padded to a multiple of this.
constexpr size_t kAlignment = 64;
constexpr const char* kMagic = "\x93NUMPY";
// Of one array; a damaged archive must not fill the memory.
constexpr size_t kMaxSize = size_t{1} << 27;

using Utf32 = std::wstring_convert<std::codecvt_utf8<char32_t>, char32_t>;

// What follows `key` in the dictionary that is the header, from the first
// character that is not blank.
std::string_view ValueOf(const std::string& key, std::string_view header) {
  const size_t position = header.find("'" + key + "':");
  if (position == std::string_view::npos) return {};
  const std::string_view value = header.substr(position + key.size() + 3);
  return value.substr(std::min(value.find_first_not_of(' '), value.size()));
}

// "(31, 3, 3)", "(31,)" or "()"; false if it is none.
bool ParseShape(std::string_view text, std::vector<size_t>* shape) {
  const size_t end = text.find(')');
  if (text.empty() || text[0] != '(' || end == std::string_view::npos) {
    return false;
  }
  text = text.substr(1, end - 1);
  while (!text.empty()) {
    const size_t comma = std::min(text.find(','), text.size());
    std::string_view number = text.substr(0, comma);
    number.remove_prefix(
        std::min(number.find_first_not_of(' '), number.size()));
    uint32_t size = 0;
    if (!ParseNumber(std::string(number), &size)) return false;
    shape->push_back(size);
    text.remove_prefix(std::min(comma + 1, text.size()));
    if (text.find_first_not_of(' ') == std::string_view::npos) break;
  }
  return true;
}

template <typename T>
void AppendNumber(const char* data, NumpyArray* array) {
  T value;
  std::memcpy(&value, data, sizeof(T));
  array->numbers.push_back(static_cast<double>(value));
}

void AppendText(const char* data, size_t num_characters, NumpyArray* array) {
  std::u32string text(num_characters, U'\0');
  std::memcpy(text.data(), data, num_characters * sizeof(char32_t));
  text.resize(text.find_last_not_of(U'\0') + 1);
  array->texts.push_back(Utf32("?").to_bytes(text));
}

// Bytes of an element of that type, 0 for a type that is not read.
size_t ElementSize(const std::string& type) {
  if (type == "<f8" || type == "<i8") return 8;
  if (type == "<f4" || type == "<i4") return 4;
  uint16_t num_characters = 0;
  if (type.compare(0, 2, "<U") == 0 &&
      ParseNumber(type.substr(2), &num_characters)) {
    return sizeof(char32_t) * num_characters;
  }
  return 0;
}

void AppendElement(const std::string& type,
                   const char* data,
                   NumpyArray* array) {
  if (type == "<f8") {
    AppendNumber<double>(data, array);
  } else if (type == "<f4") {
    AppendNumber<float>(data, array);
  } else if (type == "<i8") {
    AppendNumber<int64_t>(data, array);
  } else if (type == "<i4") {
    AppendNumber<int32_t>(data, array);
  } else {
    AppendText(data, ElementSize(type) / sizeof(char32_t), array);
  }
}

// The header of a .npy file, version 1.
std::string MakeHeader(const std::string& type,
                       const std::vector<size_t>& shape) {
  std::string dictionary =
      "{'descr': '" + type + "', 'fortran_order': False, 'shape': (";
  for (const size_t size : shape) dictionary += std::to_string(size) + ",";
  dictionary += "), }";
  const size_t prefix = std::strlen(kMagic) + 4;
  while ((prefix + dictionary.size() + 1) % kAlignment != 0) dictionary += ' ';
  dictionary += '\n';
  std::string header = kMagic;
  header += {1, 0};
  header += static_cast<char>(dictionary.size() & 0xff);
  header += static_cast<char>(dictionary.size() >> 8);
  return header + dictionary;
}

std::string ToNpy(const NumpyArray& array) {
  if (array.texts.empty()) {
    return MakeHeader("<f8", array.shape) +
           std::string(reinterpret_cast<const char*>(array.numbers.data()),
                       array.numbers.size() * sizeof(double));
  }
  std::vector<std::u32string> texts;
  size_t num_characters = 1;
  for (const std::string& text : array.texts) {
    try {
      texts.push_back(Utf32().from_bytes(text));
    } catch (const std::range_error&) {
      throw InputError("npz: the name '" + text +
                       "' is not in UTF-8. Rename it, or choose another "
                       "format.");
    }
    num_characters = std::max(num_characters, texts.back().size());
  }
  std::string npy =
      MakeHeader("<U" + std::to_string(num_characters), array.shape);
  for (std::u32string& text : texts) {
    text.resize(num_characters);
    npy.append(reinterpret_cast<const char*>(text.data()),
               num_characters * sizeof(char32_t));
  }
  return npy;
}

}  // namespace

NpzFile::NpzFile(const std::string& path) : path_(path), archive_(nullptr) {
  ReadInputFile(path);  // says what is wrong with the path
  archive_ = unzOpen64(path.c_str());
  if (archive_ == nullptr) {
    throw InputError(path +
                     ": the file is no .npz of NumPy, or cut off. Write it "
                     "again.");
  }
}

NpzFile::~NpzFile() { unzClose(archive_); }

void NpzFile::Fail(const std::string& name, const std::string& text) const {
  throw InputError(path_ + ": the array " + name + " " + text + ".");
}

// The content of NAME.npy, empty without.
std::string NpzFile::ReadMember(const std::string& name) const {
  unz_file_info64 info;
  if (unzLocateFile(archive_, (name + ".npy").c_str(), 1) != UNZ_OK) return "";
  if (unzGetCurrentFileInfo64(
          archive_, &info, nullptr, 0, nullptr, 0, nullptr, 0) != UNZ_OK ||
      info.uncompressed_size > kMaxSize ||
      unzOpenCurrentFile(archive_) != UNZ_OK) {
    Fail(name, "cannot be unpacked");
  }
  std::string content(info.uncompressed_size, '\0');
  const int num_read =
      unzReadCurrentFile(archive_, content.data(), content.size());
  // Checks the checksum.
  if (unzCloseCurrentFile(archive_) != UNZ_OK || num_read < 0 ||
      static_cast<size_t>(num_read) != content.size()) {
    Fail(name, "is damaged");
  }
  return content;
}

std::optional<NumpyArray> NpzFile::Find(const std::string& name) const {
  const std::string content = ReadMember(name);
  if (content.empty()) return std::nullopt;
  const size_t magic_size = std::strlen(kMagic);
  // Version 1 has two bytes for the length of the header, later ones four.
  const size_t length_size =
      content.size() > magic_size && content[magic_size] == 1 ? 2 : 4;
  const size_t begin = magic_size + 2 + length_size;
  if (content.size() < begin || content.compare(0, magic_size, kMagic) != 0) {
    Fail(name, "has no header of NumPy");
  }
  uint32_t length = 0;
  std::memcpy(&length, content.data() + magic_size + 2, length_size);
  const std::string_view header =
      std::string_view(content).substr(begin, length);
  const std::string_view quoted = ValueOf("descr", header);
  const std::string type(
      quoted.substr(std::min<size_t>(1, quoted.size()),
                    quoted.substr(std::min<size_t>(1, quoted.size()))
                        .find(quoted.empty() ? '\'' : quoted[0])));
  const size_t element_size = ElementSize(type);
  if (element_size == 0) {
    Fail(name,
         "is of type '" + type +
             "', not of 4 or 8 byte numbers or texts (little-endian)");
  }
  NumpyArray array;
  if (ValueOf("fortran_order", header).compare(0, 5, "False") != 0 ||
      !ParseShape(ValueOf("shape", header), &array.shape)) {
    Fail(name, "is not in C order, or has a damaged header");
  }
  size_t num_elements = 1;
  for (const size_t size : array.shape) {
    num_elements *= size;
    if (num_elements > kMaxSize) Fail(name, "has a damaged header");
  }
  if (content.size() != begin + length + num_elements * element_size) {
    Fail(name, "has another size than its header tells");
  }
  for (size_t i = 0; i < num_elements; ++i) {
    AppendElement(
        type, content.data() + begin + length + i * element_size, &array);
  }
  return array;
}

NumpyArray NpzFile::At(const std::string& name) const {
  std::optional<NumpyArray> array = Find(name);
  if (!array) Fail(name, "is missing");
  return *std::move(array);
}

void WriteNpz(const std::string& path,
              const std::vector<std::pair<std::string, NumpyArray>>& arrays) {
  std::vector<std::pair<std::string, std::string>> members;
  for (const auto& [name, array] : arrays) {
    members.emplace_back(name + ".npy", ToNpy(array));
  }
  zip_fileinfo info = {};
  info.tmz_date.tm_year = 1980;  // the same bytes every time
  info.tmz_date.tm_mday = 1;
  zipFile archive = zipOpen64(path.c_str(), APPEND_STATUS_CREATE);
  bool is_written = archive != nullptr;
  for (const auto& [name, content] : members) {
    is_written = is_written &&
                 zipOpenNewFileInZip(archive,
                                     name.c_str(),
                                     &info,
                                     nullptr,
                                     0,
                                     nullptr,
                                     0,
                                     nullptr,
                                     /*method=*/0,
                                     /*level=*/0) == ZIP_OK &&
                 zipWriteInFileInZip(archive, content.data(), content.size()) ==
                     ZIP_OK &&
                 zipCloseFileInZip(archive) == ZIP_OK;
  }
  if (archive == nullptr || zipClose(archive, nullptr) != ZIP_OK ||
      !is_written) {
    throw OutputError(path +
                      ": cannot write the file. Does its folder exist, "
                      "is it writable, and is the disk not full?");
  }
}

}  // namespace mfir
