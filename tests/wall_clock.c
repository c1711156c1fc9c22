/* Preloaded by test_clock_steps.py: a wall clock that can be set for some processes alone.

   The file that WALL_CLOCK names holds by how many seconds it is set (int64), and may change at
   any time. It counts for processes whose command line contains WALL_CLOCK_OF; each of them leaves
   its process number in WALL_CLOCK_SEEN when it first sees the clock set. Monotonic clocks are left
   as they are. Who waits for a time of the wall clock waits as long as the kernel would have him
   wait: longer, if the clock is set back meanwhile. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <semaphore.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

static int concerned(void) {
    static char line[4096];
    int file = open("/proc/self/cmdline", O_RDONLY);
    ssize_t length = read(file, line, sizeof line - 1);
    close(file);
    for (ssize_t i = 0; i + 1 < length; i++)
        if (!line[i]) line[i] = ' ';
    return strstr(line, getenv("WALL_CLOCK_OF")) != 0;
}

static int64_t step(void) {
    static volatile int64_t *seconds;
    static int concerns, seen;
    if (!seconds) {
        concerns = concerned();
        seconds = mmap(0, 8, PROT_READ, MAP_SHARED, open(getenv("WALL_CLOCK"), O_RDONLY), 0);
    }
    if (!concerns || !*seconds) return 0;
    if (!__atomic_exchange_n(&seen, 1, __ATOMIC_SEQ_CST)) {
        int file = open(getenv("WALL_CLOCK_SEEN"), O_WRONLY | O_APPEND | O_CREAT, 0600);
        dprintf(file, "%d\n", (int)getpid());
        close(file);
    }
    return *seconds;
}

int clock_gettime(clockid_t clock, struct timespec *now) {
    int failed = (int)syscall(SYS_clock_gettime, clock, now);
    if (!failed && (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE))
        now->tv_sec += step();
    return failed;
}

int gettimeofday(struct timeval *now, void *zone) {
    struct timespec exact;
    (void)zone;
    clock_gettime(CLOCK_REALTIME, &exact);
    now->tv_sec = exact.tv_sec;
    now->tv_usec = exact.tv_nsec / 1000;
    return 0;
}

time_t time(time_t *now) {
    struct timespec exact;
    clock_gettime(CLOCK_REALTIME, &exact);
    if (now) *now = exact.tv_sec;
    return exact.tv_sec;
}

/* No machine has been up for thirty years: what is later is a deadline on the wall clock. */
#define WAIT(CALL)                                                          \
    do {                                                                    \
        int64_t set = deadline->tv_sec > 1000000000 ? step() : 0, now;      \
        struct timespec due = *deadline;                                    \
        due.tv_sec -= set;                                                  \
        int result = (CALL);                                                \
        if (deadline->tv_sec <= 1000000000) return result;                  \
        now = step();                                                       \
        if (!TIMED_OUT(result) || now >= set) return result;                \
    } while (1)

int pthread_cond_timedwait(pthread_cond_t *c, pthread_mutex_t *m, const struct timespec *deadline) {
    static int (*wait)(pthread_cond_t *, pthread_mutex_t *, const struct timespec *);
    if (!wait) wait = dlvsym(RTLD_NEXT, "pthread_cond_timedwait", "GLIBC_2.3.2");
#define TIMED_OUT(result) ((result) == ETIMEDOUT)
    WAIT(wait(c, m, &due));
}

int pthread_mutex_timedlock(pthread_mutex_t *m, const struct timespec *deadline) {
    static int (*lock)(pthread_mutex_t *, const struct timespec *);
    if (!lock) lock = dlsym(RTLD_NEXT, "pthread_mutex_timedlock");
    WAIT(lock(m, &due));
}
#undef TIMED_OUT

int sem_timedwait(sem_t *s, const struct timespec *deadline) {
    static int (*wait)(sem_t *, const struct timespec *);
    if (!wait) wait = dlsym(RTLD_NEXT, "sem_timedwait");
#define TIMED_OUT(result) ((result) && errno == ETIMEDOUT)
    WAIT(wait(s, &due));
}
