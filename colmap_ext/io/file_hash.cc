#include "colmap_ext/io/file_hash.h"

#include <cstdio>
#include <fstream>
#include <memory>
#include <vector>

#include <openssl/evp.h>

#include "src/util/errors.h"

namespace mfir {

FileHash HashFile(const std::string& path) {
  constexpr size_t kBlockSize = 1 << 20;
  const auto fail = [&path]() {
    throw InputError(path + ": cannot read the file.");
  };
  const std::unique_ptr<EVP_MD_CTX, decltype(&EVP_MD_CTX_free)> context(
      EVP_MD_CTX_new(), &EVP_MD_CTX_free);
  std::ifstream file(path, std::ios::binary);
  if (!file || EVP_DigestInit_ex(context.get(), EVP_sha256(), nullptr) != 1) {
    fail();
  }
  FileHash hash;
  std::vector<char> block(kBlockSize);
  while (file) {
    file.read(block.data(), static_cast<std::streamsize>(block.size()));
    const auto count = static_cast<size_t>(file.gcount());
    hash.bytes += count;
    EVP_DigestUpdate(context.get(), block.data(), count);
  }
  if (file.bad()) fail();
  unsigned char digest[EVP_MAX_MD_SIZE];
  unsigned size = 0;
  EVP_DigestFinal_ex(context.get(), digest, &size);
  for (unsigned i = 0; i < size; ++i) {
    char text[3];
    std::snprintf(text, sizeof(text), "%02x", digest[i]);
    hash.sha256 += text;
  }
  return hash;
}

}  // namespace mfir
