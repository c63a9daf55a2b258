/* Preloaded, it makes a disk full from the n-th write to a file on: for
 * tests/faulty_runs.sh.
 *
 *   MFIR_FAIL_FROM   n; 0: none fails
 *   MFIR_FAIL_COUNT  a file that gets the number of writes at the end
 *
 * Counted are writes to regular files and what makes files and folders, but for
 * those in /dev and /proc. C++ streams and SQLite call what is here; C's own
 * streams end in fwrite, fflush and fclose. */

#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <unistd.h>

static atomic_long num_calls = 0;
static long fail_from = 0;

__attribute__((constructor)) static void Begin(void) {
  const char* from = getenv("MFIR_FAIL_FROM");
  fail_from = from != NULL ? atol(from) : 0;
}

__attribute__((destructor)) static void End(void) {
  const char* path = getenv("MFIR_FAIL_COUNT");
  if (path == NULL) return;
  fail_from = 0;
  const long count = num_calls;
  FILE* file = fopen(path, "w");
  if (file == NULL) return;
  fprintf(file, "%ld\n", count);
  fclose(file);
}

static int Fails(void) {
  const long number = atomic_fetch_add(&num_calls, 1) + 1;
  if (fail_from == 0 || number < fail_from) return 0;
  errno = ENOSPC;
  return 1;
}

static int FileFails(int file) {
  struct stat status;
  return file > STDERR_FILENO && fstat(file, &status) == 0 &&
         S_ISREG(status.st_mode) && status.st_nlink > 0 && Fails();
}

static int PathFails(const char* path) {
  return strncmp(path, "/dev/", 5) != 0 && strncmp(path, "/proc/", 6) != 0 &&
         Fails();
}

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

ssize_t write(int file, const void* data, size_t size) {
  return FileFails(file) ? -1 : REAL(write)(file, data, size);
}

ssize_t writev(int file, const struct iovec* parts, int count) {
  return FileFails(file) ? -1 : REAL(writev)(file, parts, count);
}

ssize_t pwrite(int file, const void* data, size_t size, off_t offset) {
  return FileFails(file) ? -1 : REAL(pwrite)(file, data, size, offset);
}

ssize_t pwrite64(int file, const void* data, size_t size, off64_t offset) {
  return FileFails(file) ? -1 : REAL(pwrite64)(file, data, size, offset);
}

int mkdir(const char* path, mode_t mode) {
  return PathFails(path) ? -1 : REAL(mkdir)(path, mode);
}

size_t fwrite(const void* data, size_t size, size_t count, FILE* file) {
  return FileFails(fileno(file)) ? 0 : REAL(fwrite)(data, size, count, file);
}

static int Makes(int flags) { return (flags & O_CREAT) != 0; }

#define OPEN(name)                                               \
  int name(const char* path, int flags, ...) {                   \
    mode_t mode = 0;                                             \
    if (Makes(flags)) {                                          \
      va_list arguments;                                         \
      va_start(arguments, flags);                                \
      mode = va_arg(arguments, mode_t);                          \
      va_end(arguments);                                         \
      if (access(path, F_OK) != 0 && PathFails(path)) return -1; \
    }                                                            \
    return REAL(name)(path, flags, mode);                        \
  }
OPEN(open)
OPEN(open64)

static int IsNew(const char* path, const char* mode) {
  return mode[0] != 'r' && access(path, F_OK) != 0;
}

FILE* fopen(const char* path, const char* mode) {
  return IsNew(path, mode) && PathFails(path) ? NULL : REAL(fopen)(path, mode);
}

FILE* fopen64(const char* path, const char* mode) {
  return IsNew(path, mode) && PathFails(path) ? NULL
                                              : REAL(fopen64)(path, mode);
}
