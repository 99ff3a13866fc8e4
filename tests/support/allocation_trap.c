/* A library to preload: it ends the process at an allocation or a release while `trap_armed` is set. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdlib.h>
#include <unistd.h>
int trap_armed;
static void caught(void) { if (trap_armed) { write(2, "TRAPPED\n", 8); _exit(7); } }
extern void *__libc_malloc(size_t); extern void *__libc_calloc(size_t, size_t);
extern void *__libc_realloc(void *, size_t); extern void __libc_free(void *);
void *malloc(size_t n) { caught(); return __libc_malloc(n); }
void *calloc(size_t n, size_t m) { caught(); return __libc_calloc(n, m); }
void *realloc(void *p, size_t n) { caught(); return __libc_realloc(p, n); }
void free(void *p) { caught(); __libc_free(p); }
