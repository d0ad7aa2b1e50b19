/* What the operations of a step need beside C's own. */
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#if defined(__GNUC__)
#define TJ_ALIGNED __attribute__((aligned(64)))
#define TJ_UNUSED __attribute__((unused))
#define TJ_APART static __attribute__((noinline, unused))
#else
#define TJ_ALIGNED
#define TJ_UNUSED
#define TJ_APART static
#endif
#define TJ static inline TJ_UNUSED

/* A whole number within 0 to most: where an index that points outside goes. */
TJ int32_t tj_within(int32_t at, int32_t most) { return at < 0 ? 0 : at > most ? most : at; }

/* NaN wins, as in XLA; whole numbers that are divided by 0 are too. */
#define TJ_FLOATS(T, I, fmod_)                                                              \
  TJ T tj_either_##T(int first, T a, T b) { return first ? a : b; }                         \
  TJ T tj_max_##T(T a, T b) { return a > b || a != a ? a : b; }                             \
  TJ T tj_min_##T(T a, T b) { return a < b || a != a ? a : b; }                             \
  TJ T tj_largest_##T(int n, const T *a) {                                                  \
    T most = -INFINITY;                                                                     \
    int none = 0;                                                                           \
    _Pragma("omp simd reduction(max:most) reduction(|:none)")                               \
    for (int i = 0; i < n; i++) {                                                           \
      most = a[i] > most ? a[i] : most;                                                     \
      none |= a[i] != a[i];                                                                 \
    }                                                                                       \
    return none ? NAN : most;                                                               \
  }                                                                                         \
  TJ int32_t tj_largest_at_##T(int n, const T *a) {                                         \
    const T most = tj_largest_##T(n, a);                                                    \
    for (int i = 0; i < n; i++)                                                             \
      if (most != most ? a[i] != a[i] : a[i] == most) return i;                             \
    return 0;                                                                               \
  }                                                                                         \
  TJ T tj_square_##T(T a) { return a * a; }                                                 \
  TJ T tj_sign_##T(T a) { return a != a ? a : (T)((a > 0) - (a < 0)); }                     \
  TJ T tj_whole_power_##T(T a, int n) {                                                     \
    T found = 1, x = a;                                                                     \
    int begun = 0;                                                                          \
    for (; n > 0; n >>= 1) {                                                                \
      if (n & 1) { found = begun ? found * x : x; begun = 1; }                              \
      x = x * x;                                                                            \
    }                                                                                       \
    return found;                                                                           \
  }                                                                                         \
  TJ void tj_lu_##T(int n, T *a, int32_t *pivot, int32_t *order) {                          \
    for (int i = 0; i < n; i++) order[i] = i;                                               \
    for (int k = 0; k < n; k++) {                                                           \
      int best = k;                                                                         \
      T size = a[k * n + k] < 0 ? -a[k * n + k] : a[k * n + k];                             \
      for (int i = k + 1; i < n; i++) {                                                     \
        const T other = a[i * n + k] < 0 ? -a[i * n + k] : a[i * n + k];                    \
        if (other > size) { size = other; best = i; }                                       \
      }                                                                                     \
      pivot[k] = best;                                                                      \
      if (best != k) {                                                                      \
        const int32_t other = order[k];                                                     \
        order[k] = order[best];                                                             \
        order[best] = other;                                                                \
        for (int j = 0; j < n; j++) {                                                       \
          const T held = a[k * n + j];                                                      \
          a[k * n + j] = a[best * n + j];                                                   \
          a[best * n + j] = held;                                                           \
        }                                                                                   \
      }                                                                                     \
      for (int i = k + 1; i < n; i++) {                                                     \
        const T part = a[i * n + k] / a[k * n + k];                                         \
        a[i * n + k] = part;                                                                \
        for (int j = k + 1; j < n; j++) a[i * n + j] -= part * a[k * n + j];                \
      }                                                                                     \
    }                                                                                       \
  }                                                                                         \
  TJ void tj_triangular_##T(int n, int m, const T *a, T *b, int lower, int turned,          \
                            int unit) {                                                     \
    for (int step = 0; step < n; step++) {                                                  \
      const int i = lower ? step : n - 1 - step;                                            \
      for (int k = lower ? 0 : i + 1; k < (lower ? i : n); k++) {                           \
        const T part = turned ? a[k * n + i] : a[i * n + k];                                \
        for (int j = 0; j < m; j++) b[i * m + j] -= part * b[k * m + j];                    \
      }                                                                                     \
      if (!unit)                                                                            \
        for (int j = 0; j < m; j++) b[i * m + j] /= a[i * n + i];                           \
    }                                                                                       \
  }
#define TJ_WHOLE(T, MIN)                                                                    \
  TJ T tj_either_##T(int first, T a, T b) { return first ? a : b; }                         \
  TJ T tj_max_##T(T a, T b) { return a > b ? a : b; }                                       \
  TJ T tj_min_##T(T a, T b) { return a < b ? a : b; }                                       \
  TJ T tj_sign_##T(T a) { return (T)((a > 0) - (a < 0)); }                                  \
  TJ T tj_square_##T(T a) { return (T)((uint64_t)a * (uint64_t)a); }                        \
  TJ T tj_whole_power_##T(T a, int n) {                                                     \
    uint64_t found = 1;                                                                     \
    while (n-- > 0) found *= (uint64_t)a;                                                   \
    return (T)found;                                                                        \
  }                                                                                         \
  TJ T tj_div_##T(T a, T b) { return b == 0 ? (T)-1 : a == MIN && b == (T)-1 ? a : a / b; } \
  TJ T tj_rem_##T(T a, T b) { return b == 0 ? a : a == MIN && b == (T)-1 ? 0 : a % b; }

TJ_FLOATS(float, int32_t, fmodf)
TJ_FLOATS(double, int64_t, fmod)
TJ_WHOLE(int32_t, INT32_MIN)
TJ_WHOLE(int64_t, INT64_MIN)
TJ_WHOLE(uint8_t, 1)
TJ_WHOLE(uint32_t, 1)

/* A float that no whole number is becomes the nearest; NaN becomes 0. */
TJ int32_t tj_to_int32_t(double a) {
  return a != a ? 0 : a >= 2147483647. ? INT32_MAX : a <= -2147483648. ? INT32_MIN : (int32_t)a;
}
TJ int64_t tj_to_int64_t(double a) {
  return a != a                       ? 0
         : a >= 9223372036854775807. ? INT64_MAX
         : a <= -9223372036854775808. ? INT64_MIN
                                       : (int64_t)a;
}
TJ uint8_t tj_to_uint8_t(double a) { return a != a || a <= 0 ? 0 : a >= 255 ? 255 : (uint8_t)a; }
TJ uint32_t tj_to_uint32_t(double a) {
  return a != a || a <= 0 ? 0 : a >= 4294967295. ? UINT32_MAX : (uint32_t)a;
}
#define TJ_BITS(A, B)                                                                       \
  TJ B tj_bits_##A##_##B(A a) {                                                             \
    B b;                                                                                    \
    memcpy(&b, &a, sizeof b);                                                               \
    return b;                                                                               \
  }
TJ_BITS(float, int32_t)
TJ_BITS(int32_t, float)
TJ_BITS(double, int64_t)
TJ_BITS(int64_t, double)
TJ_BITS(float, uint32_t)
TJ_BITS(uint32_t, float)

/* Products of N rows, row[k * N + v], with one matrix, a block of its columns after the
 * other: the sums stay in registers. A function of its own, which compilers see through best. */
#define TJ_DOTS_BLOCK(T, N, L)                                                              \
  for (; i <= wide - L; i += L) {                                                           \
    T s[N][L] = {{0}};                                                                      \
    for (int k = 0; k < n; k++)                                                             \
      for (int v = 0; v < N; v++) {                                                         \
        _Pragma("omp simd")                                                                 \
        for (int l = 0; l < L; l++) s[v][l] += row[k * N + v] * matrix[k * wide + i + l];   \
      }                                                                                     \
    for (int v = 0; v < N; v++)                                                             \
      for (int l = 0; l < L; l++) out[v * wide + i + l] = s[v][l];                          \
  }
#define TJ_DOTS(T, N, L)                                                                    \
  TJ_APART void tj_dots##N##_##T(int n, int wide, const T *restrict matrix,                 \
                                 const T *restrict row, T *restrict out) {                  \
    int i = 0;                                                                              \
    TJ_DOTS_BLOCK(T, N, L)                                                                  \
    TJ_DOTS_BLOCK(T, N, 16)                                                                 \
    TJ_DOTS_BLOCK(T, N, 1)                                                                  \
  }
#define TJ_EACH_DOTS(T)                                                                     \
  TJ_DOTS(T, 1, 64)                                                                         \
  TJ_DOTS(T, 2, 16)                                                                         \
  TJ_DOTS(T, 3, 16)                                                                         \
  TJ_DOTS(T, 4, 16)                                                                         \
  TJ_DOTS(T, 5, 16)                                                                         \
  TJ_DOTS(T, 6, 16)                                                                         \
  TJ_DOTS(T, 7, 16)
TJ_EACH_DOTS(float)
TJ_EACH_DOTS(double)
