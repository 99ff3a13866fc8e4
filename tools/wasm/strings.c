/* The functions of the C library that the core calls in WebAssembly; clang makes all others inline. */

#include <string.h>

int memcmp(const void *one, const void *other, size_t bytes)
{
    const unsigned char *a = one, *b = other;
    for (size_t at = 0; at < bytes; at++)
        if (a[at] != b[at])
            return a[at] - b[at];
    return 0;
}

int strncmp(const char *one, const char *other, size_t bytes)
{
    const unsigned char *a = (const unsigned char *)one, *b = (const unsigned char *)other;
    for (size_t at = 0; at < bytes; at++)
        if (a[at] != b[at] || !a[at])
            return a[at] - b[at];
    return 0;
}

char *strcpy(char *to, const char *from)
{
    for (char *at = to; (*at++ = *from++) != 0;)
        ;
    return to;
}
