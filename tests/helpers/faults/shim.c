/* Library for LD_PRELOAD: counts the writes, syncs, renames and removals below one folder and disturbs one of them.

   FAULT_ROOT is the folder, FAULT_CONTROL a file of four 64-bit integers that is mapped into memory: the number of
   operations so far, the number of the operation to disturb (0 for none, -1 to list all in FAULT_LIST), how, and the
   number of disturbed ones. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

enum { FAIL = 1, FULL, TEAR, KILL, DELAY };

struct control { int64_t count, at, kind, hits; };

static struct control *control;
static char root[PATH_MAX];
static size_t root_length;
static int list = -1;
static __thread char place[PATH_MAX];

__attribute__((constructor)) static void begin(void) {
    const char *file = getenv("FAULT_CONTROL"), *folder = getenv("FAULT_ROOT");
    if (!file || !folder || !realpath(folder, root)) return;
    root_length = strlen(root);
    int fd = open(file, O_RDWR | O_CLOEXEC);
    if (fd < 0) return;
    void *mapped = mmap(NULL, sizeof *control, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    close(fd);
    if (mapped != MAP_FAILED) control = mapped;
    const char *listed = getenv("FAULT_LIST");
    if (listed) list = open(listed, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0600);
}

static int inside_path(const char *path) {
    char full[PATH_MAX];
    if (!control || !path) return 0;
    if (path[0] != '/') {
        if (!getcwd(full, sizeof full) || strlen(full) + strlen(path) + 2 > sizeof full) return 0;
        strcat(strcat(full, "/"), path);
        path = full;
    }
    if (strncmp(path, root, root_length) || path[root_length] != '/') return 0;
    snprintf(place, sizeof place, "%s", path + root_length);
    return 1;
}

static int inside_fd(int fd) {
    char link[64], path[PATH_MAX];
    if (!control || fd < 3) return 0;
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t n = readlink(link, path, sizeof path - 1);
    if (n <= 0) return 0;
    path[n] = 0;
    return inside_path(path);
}

static int inside_at(int folder, const char *path) {
    char link[64], full[PATH_MAX];
    if (!control || !path) return 0;
    if (path[0] == '/' || folder == AT_FDCWD) return inside_path(path);
    snprintf(link, sizeof link, "/proc/self/fd/%d", folder);
    ssize_t n = readlink(link, full, sizeof full - 1);
    if (n <= 0 || n + strlen(path) + 2 > sizeof full) return 0;
    full[n] = 0;
    strcat(strcat(full, "/"), path);
    return inside_path(full);
}

static void die(void) { kill(getpid(), SIGKILL); pause(); }

/* Count an operation; return how it is disturbed, 0 for not at all. A full disk stays full. */
static int64_t disturbed(const char *name) {
    int64_t number = __atomic_add_fetch(&control->count, 1, __ATOMIC_SEQ_CST), at = control->at;
    if (at < 0 && list >= 0) {
        char line[PATH_MAX + 32];
        int n = snprintf(line, sizeof line, "%s %s\n", name, place);
        if (n > 0) (void)!syscall(SYS_write, list, line, (size_t)n);
    }
    if (at <= 0 || number < at || (number > at && control->kind != FULL)) return 0;
    __atomic_add_fetch(&control->hits, 1, __ATOMIC_SEQ_CST);
    if (control->kind == DELAY) usleep(150000);
    return control->kind;
}

#define REAL(name) ({ static __typeof__(name) *real; if (!real) real = dlsym(RTLD_NEXT, #name); real; })

/* What a write does: `part` writes half of it. */
#define WRITE(fd, call, part) \
    int64_t kind = inside_fd(fd) ? disturbed(__func__) : 0; \
    if (kind == FAIL || kind == FULL) { errno = kind == FAIL ? EIO : ENOSPC; return -1; } \
    if (kind == TEAR) { part; die(); } \
    ssize_t done = call; \
    if (kind == KILL) die(); \
    return done;

/* Any other operation: torn means killed before it. */
#define CHANGE(is_inside, call) \
    int64_t kind = (is_inside) ? disturbed(__func__) : 0; \
    if (kind == FAIL || kind == FULL) { errno = kind == FAIL ? EIO : ENOSPC; return -1; } \
    if (kind == TEAR) die(); \
    int done = call; \
    if (kind == KILL) die(); \
    return done;

ssize_t write(int fd, const void *data, size_t n) {
    WRITE(fd, REAL(write)(fd, data, n), (void)!REAL(write)(fd, data, n / 2))
}
ssize_t pwrite(int fd, const void *data, size_t n, off_t at) {
    WRITE(fd, REAL(pwrite)(fd, data, n, at), (void)!REAL(pwrite)(fd, data, n / 2, at))
}
ssize_t pwrite64(int fd, const void *data, size_t n, off64_t at) {
    WRITE(fd, REAL(pwrite64)(fd, data, n, at), (void)!REAL(pwrite64)(fd, data, n / 2, at))
}
ssize_t writev(int fd, const struct iovec *parts, int n) {
    WRITE(fd, REAL(writev)(fd, parts, n), (void)!REAL(writev)(fd, parts, n / 2))
}
ssize_t copy_file_range(int from, off64_t *from_at, int fd, off64_t *at, size_t n, unsigned flags) {
    WRITE(fd, REAL(copy_file_range)(from, from_at, fd, at, n, flags),
          (void)!REAL(copy_file_range)(from, from_at, fd, at, n / 2, flags))
}
ssize_t sendfile(int fd, int from, off_t *at, size_t n) {
    ssize_t (*real)(int, int, off_t *, size_t) = dlsym(RTLD_NEXT, "sendfile");
    WRITE(fd, real(fd, from, at, n), (void)!real(fd, from, at, n / 2))
}
ssize_t sendfile64(int fd, int from, off64_t *at, size_t n) {
    ssize_t (*real)(int, int, off64_t *, size_t) = dlsym(RTLD_NEXT, "sendfile64");
    WRITE(fd, real(fd, from, at, n), (void)!real(fd, from, at, n / 2))
}
int fsync(int fd) { CHANGE(inside_fd(fd), REAL(fsync)(fd)) }
int fdatasync(int fd) { CHANGE(inside_fd(fd), REAL(fdatasync)(fd)) }
int ftruncate(int fd, off_t n) { CHANGE(inside_fd(fd), REAL(ftruncate)(fd, n)) }
int ftruncate64(int fd, off64_t n) { CHANGE(inside_fd(fd), REAL(ftruncate64)(fd, n)) }
int rename(const char *a, const char *b) { CHANGE(inside_path(b), REAL(rename)(a, b)) }
int renameat(int f, const char *a, int g, const char *b) { CHANGE(inside_at(g, b), REAL(renameat)(f, a, g, b)) }
int unlink(const char *path) { CHANGE(inside_path(path), REAL(unlink)(path)) }
int unlinkat(int f, const char *path, int flags) { CHANGE(inside_at(f, path), REAL(unlinkat)(f, path, flags)) }
int rmdir(const char *path) { CHANGE(inside_path(path), REAL(rmdir)(path)) }
int mkdir(const char *path, mode_t mode) { CHANGE(inside_path(path), REAL(mkdir)(path, mode)) }
