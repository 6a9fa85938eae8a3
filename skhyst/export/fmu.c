/* Co-simulation of $name by FMI $version, written by skhyst. */
#include <float.h>
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "$name.h"

#define VERSION $major
#if defined(_WIN32)
#define API __declspec(dllexport)
#elif defined(__GNUC__)
#define API __attribute__((visibility("default")))
#pragma GCC diagnostic ignored "-Wunused-parameter" /* the interface has more than is needed */
#else
#define API
#endif
#ifdef FMI${major}_FUNCTION_PREFIX
#define JOINED(a, b) a##b
#define EXPANDED(a, b) JOINED(a, b)
#define FMI(f) EXPANDED(FMI${major}_FUNCTION_PREFIX, fmi${major}##f)
#else
#define FMI(f) fmi${major}##f
#endif

enum { OK = 0, WARNING = 1, ERROR = 3 };
enum { TIME, OUTPUT, INPUTS, PARAMETERS = INPUTS + ${name}_N_INPUTS };
enum { N_VALUES = PARAMETERS + $n_parameters };
typedef const uint32_t *refs;

#if VERSION == 2
typedef int boolean;
typedef char byte;
typedef void (*logger)(void *, const char *, int, const char *, const char *, ...);
#else
typedef bool boolean;
typedef uint8_t byte;
typedef void (*logger)(void *, int, const char *, const char *);
#endif

static const double first[] = {$first}; /* values of inputs and parameters */

/* All that changes, by value: time, output, inputs and parameters, and the model's state. */
typedef struct {
    double values[N_VALUES];
    ${name}_state model;
} snapshot;

typedef struct {
    snapshot now;
    double start;
    void *environment;
    logger log;
    char name[];
} unit;

/* Errors and warnings are reported even if debug logging is off. */
static int told(const unit *it, int status, const char *message)
{
    if (it->log) {
#if VERSION == 2
        it->log(it->environment, it->name, status, "logStatusError", message);
#else
        it->log(it->environment, status, "logStatusError", message);
#endif
    }
    return status;
}

static int refused(const unit *it, const char *message) { return told(it, ERROR, message); }

/* Put the parameters in force. */
static int configured(unit *it)
{
$configure}

/* Before the first step the output is the response to the start input in the initial state. */
static void answered(unit *it)
{
    const double *const u = it->now.values + INPUTS;
    const ${name}_state state = it->now.model;
    it->now.values[OUTPUT] = ${name}_step(&it->now.model, $u);
    it->now.model = state;
}

static void begin(unit *it)
{
    memcpy(it->now.values + INPUTS, first, sizeof first);
    ${name}_init(&it->now.model);
    it->now.values[TIME] = it->start = 0.0;
    answered(it);
}

/* The end of the initialization: the device has rested at the start values of the inputs. */
static int initialized(unit *it)
{
    const double *const u = it->now.values + INPUTS;
    int i, others = 0;
    for (i = 0; i < ${name}_N_INPUTS; i++) {
        if (!isfinite(u[i])) {
            return refused(it, "the start value of an input is not finite");
        }
        others |= u[i] < first[i] || u[i] > first[i];
    }
    if (others) {
        $init_at
    }
    answered(it);
    return OK;
}

static unit *made(const char *name, const char *token, void *environment, logger log)
{
    unit *it = name ? calloc(1, sizeof *it + strlen(name) + 1) : NULL;
    if (!it) {
        return NULL;
    }
    strcpy(it->name, name);
    it->environment = environment;
    it->log = log;
    if (!token || strcmp(token, ${name}_HASH) != 0) {
        refused(it, "the model description is that of another model");
        free(it);
        return NULL;
    }
    begin(it);
    return it;
}

/* One step of the model for each sampling interval, with the input held. A size is a difference of
   two times, each rounded as product and as sum, the difference itself rounded, and compared with a
   rounded product: half an epsilon of the largest of these numbers, six times. */
static int stepped(unit *it, double time, double size)
{
    const double *const u = it->now.values + INPUTS;
    const double n = round(size / ${name}_DT);
    const double largest = fabs(time) + fabs(it->start) + fabs(size);
    if (!(n >= 1.0 && fabs(size - n * ${name}_DT) <= 3.0 * DBL_EPSILON * largest)) {
        char message[160];
        snprintf(message, sizeof message,
                 "a step of %.17g s is not a whole multiple of the sampling interval of %.17g s",
                 size, ${name}_DT);
        return refused(it, message);
    }
    for (int i = 0; i < ${name}_N_INPUTS; i++) {
        if (!isfinite(it->now.values[INPUTS + i])) {
            return refused(it, "the input is not finite");
        }
    }
    const uint32_t before = ${name}_status(&it->now.model);
    for (double k = 0.0; k < n; k++) {
        it->now.values[OUTPUT] = ${name}_step(&it->now.model, $u);
    }
    it->now.values[TIME] = time + size;
    if (~before & ${name}_status(&it->now.model) & ${name}_OVERRANGE) {
        return told(it, WARNING, "numbers have left floating point: the last output was held, and "
                                 "the state begins anew");
    }
    return OK;
}

static int valid(const unit *it, refs which, size_t n, uint32_t least)
{
    for (size_t k = 0; k < n; k++) {
        if (which[k] < least || which[k] >= N_VALUES) {
            return refused(it, least ? "only inputs and parameters can be set"
                                     : "there is no such variable");
        }
    }
    return OK;
}

static int get(const unit *it, refs which, size_t n, double *values)
{
    const int status = valid(it, which, n, 0);
    for (size_t k = 0; k < n && status == OK; k++) {
        values[k] = it->now.values[which[k]];
    }
    return status;
}

static int set(unit *it, refs which, size_t n, const double *values)
{
    const int status = valid(it, which, n, INPUTS);
    const snapshot before = it->now;
    int tuned = 0;
    for (size_t k = 0; k < n && status == OK; k++) {
        it->now.values[which[k]] = values[k];
        tuned |= which[k] >= PARAMETERS;
    }
    if (tuned && configured(it) != OK) {
        it->now = before;
        return ERROR;
    }
    return status;
}

static int begun(unit *it, double start)
{
    it->now.values[TIME] = it->start = start;
    return OK;
}

static int copied(const unit *it, const void *from, void **to)
{
    if (!*to && !(*to = malloc(sizeof(snapshot)))) {
        return refused(it, "there is no memory for the state");
    }
    memcpy(*to, from, sizeof(snapshot));
    return OK;
}

static int unpacked(const unit *it, const byte *from, size_t size, void **to)
{
    return size == sizeof(snapshot) ? copied(it, from, to) : refused(it, "this is another state");
}

static int reset(unit *it)
{
    begin(it);
    return OK;
}

static int released(void **state)
{
    if (state) {
        free(*state);
        *state = NULL;
    }
    return OK;
}

#if VERSION == 2
#define STATE(before, after) FMI(before##FMUstate##after)
#define UNPACK FMI(DeSerializeFMUstate)
#else
#define STATE(before, after) FMI(before##FMUState##after)
#define UNPACK FMI(DeserializeFMUState)
#endif
#define DONE { return OK; }
#define ABSENT(f, ...) API int FMI(f)(__VA_ARGS__) { return ERROR; }
/* Access to values of types that no variable has: an error, unless it is to zero values. */
#define NONE(f, ...) \
    API int FMI(f)(void *it, refs r, size_t n, __VA_ARGS__) { return n == 0 ? OK : ERROR; }

API const char *FMI(GetVersion)(void) { return "$version"; }
API int FMI(SetDebugLogging)(void *it, boolean on, size_t n, const char *const *s) DONE
API void FMI(FreeInstance)(void *it) { free(it); }
API int FMI(ExitInitializationMode)(void *it) { return initialized(it); }
API int FMI(Terminate)(void *it) DONE
API int FMI(Reset)(void *it) { return reset(it); }
API int STATE(Get, )(void *it, void **to) { return copied(it, &((unit *)it)->now, to); }
API int STATE(Set, )(void *it, void *from)
{
    void *to = &((unit *)it)->now;
    return copied(it, from, &to);
}
API int STATE(Free, )(void *it, void **state) { return released(state); }
API int STATE(Serialized, Size)(void *it, void *state, size_t *size)
{
    *size = sizeof(snapshot);
    return OK;
}
API int STATE(Serialize, )(void *it, void *from, byte *to, size_t size)
{
    void *room = to;
    return size >= sizeof(snapshot) ? copied(it, from, &room) : refused(it, "more room is needed");
}
API int UNPACK(void *it, const byte *from, size_t size, void **to)
{
    return unpacked(it, from, size, to);
}

#if VERSION == 2
typedef struct {
    logger log;
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*finished)(void *, int);
    void *environment;
} callbacks;

API const char *FMI(GetTypesPlatform)(void) { return "default"; }
API void *FMI(Instantiate)(const char *name, int type, const char *token, const char *resources,
                           const callbacks *back, boolean visible, boolean logging)
{
    return back && type == 1 ? made(name, token, back->environment, back->log) : NULL;
}
API int FMI(SetupExperiment)(void *it, boolean has_tolerance, double tolerance, double start,
                             boolean has_stop, double stop)
{
    return begun(it, start);
}
API int FMI(EnterInitializationMode)(void *it) DONE
API int FMI(GetReal)(void *it, refs r, size_t n, double *x) { return get(it, r, n, x); }
API int FMI(SetReal)(void *it, refs r, size_t n, const double *x) { return set(it, r, n, x); }
API int FMI(DoStep)(void *it, double time, double size, boolean forget)
{
    return stepped(it, time, size);
}
NONE(GetInteger, int *x)
NONE(SetInteger, const int *x)
NONE(GetBoolean, boolean *x)
NONE(SetBoolean, const boolean *x)
NONE(GetString, const char **x)
NONE(SetString, const char *const *x)
ABSENT(GetDirectionalDerivative, void *it, refs r, size_t n, refs k, size_t m, const double *v,
       double *x)
ABSENT(SetRealInputDerivatives, void *it, refs r, size_t n, const int *order, const double *x)
ABSENT(GetRealOutputDerivatives, void *it, refs r, size_t n, const int *order, double *x)
ABSENT(CancelStep, void *it)
ABSENT(GetStatus, void *it, int kind, int *x)
ABSENT(GetRealStatus, void *it, int kind, double *x)
ABSENT(GetIntegerStatus, void *it, int kind, int *x)
ABSENT(GetBooleanStatus, void *it, int kind, boolean *x)
ABSENT(GetStringStatus, void *it, int kind, const char **x)
#else
API void *FMI(InstantiateCoSimulation)(
    const char *name, const char *token, const char *resources, bool visible, bool logging,
    bool events, bool early, refs r, size_t n, void *environment, logger log,
    void (*update)(void *, double, bool, bool, bool, bool, bool *, double *))
{
    return events ? NULL : made(name, token, environment, log);
}
API void *FMI(InstantiateModelExchange)(const char *name, const char *token, const char *resources,
                                        bool visible, bool logging, void *environment, logger log)
{
    return NULL;
}
API void *FMI(InstantiateScheduledExecution)(
    const char *name, const char *token, const char *resources, bool visible, bool logging,
    void *environment, logger log, void (*update)(void *), void (*lock)(void), void (*unlock)(void))
{
    return NULL;
}
API int FMI(EnterInitializationMode)(void *it, bool has_tolerance, double tolerance, double start,
                                     bool has_stop, double stop)
{
    return begun(it, start);
}
API int FMI(GetFloat64)(void *it, refs r, size_t n, double *x, size_t m)
{
    return m == n ? get(it, r, n, x) : refused(it, "there is one value for each variable");
}
API int FMI(SetFloat64)(void *it, refs r, size_t n, const double *x, size_t m)
{
    return m == n ? set(it, r, n, x) : refused(it, "there is one value for each variable");
}
API int FMI(DoStep)(void *it, double time, double size, bool forget, bool *event, bool *terminate,
                    bool *early, double *last)
{
    const int status = stepped(it, time, size);
    *event = *terminate = *early = false;
    *last = ((unit *)it)->now.values[TIME];
    return status;
}
#define TYPE(name, type) \
    NONE(Get##name, type *x, size_t m) \
    NONE(Set##name, const type *x, size_t m)
typedef const char *string;
TYPE(Float32, float)
TYPE(Int8, int8_t)
TYPE(UInt8, uint8_t)
TYPE(Int16, int16_t)
TYPE(UInt16, uint16_t)
TYPE(Int32, int32_t)
TYPE(UInt32, uint32_t)
TYPE(Int64, int64_t)
TYPE(UInt64, uint64_t)
TYPE(Boolean, bool)
TYPE(String, string)
NONE(GetBinary, size_t *sizes, const uint8_t **x, size_t m)
NONE(SetBinary, const size_t *sizes, const uint8_t *const *x, size_t m)
NONE(GetClock, bool *x)
NONE(SetClock, const bool *x)
ABSENT(EnterEventMode, void *it)
ABSENT(GetNumberOfVariableDependencies, void *it, uint32_t r, size_t *n)
ABSENT(GetVariableDependencies, void *it, uint32_t r, size_t *elements, uint32_t *on,
       size_t *elements_on, int *kinds, size_t n)
ABSENT(GetDirectionalDerivative, void *it, refs r, size_t n, refs k, size_t m, const double *v,
       size_t n_v, double *x, size_t n_x)
ABSENT(GetAdjointDerivative, void *it, refs r, size_t n, refs k, size_t m, const double *v,
       size_t n_v, double *x, size_t n_x)
ABSENT(EnterConfigurationMode, void *it)
ABSENT(ExitConfigurationMode, void *it)
ABSENT(GetIntervalDecimal, void *it, refs r, size_t n, double *x, int *kinds)
ABSENT(GetIntervalFraction, void *it, refs r, size_t n, uint64_t *x, uint64_t *of, int *kinds)
ABSENT(GetShiftDecimal, void *it, refs r, size_t n, double *x)
ABSENT(GetShiftFraction, void *it, refs r, size_t n, uint64_t *x, uint64_t *of)
ABSENT(SetIntervalDecimal, void *it, refs r, size_t n, const double *x)
ABSENT(SetIntervalFraction, void *it, refs r, size_t n, const uint64_t *x, const uint64_t *of)
ABSENT(SetShiftDecimal, void *it, refs r, size_t n, const double *x)
ABSENT(SetShiftFraction, void *it, refs r, size_t n, const uint64_t *x, const uint64_t *of)
ABSENT(EvaluateDiscreteStates, void *it)
ABSENT(UpdateDiscreteStates, void *it, bool *a, bool *b, bool *c, bool *d, bool *e, double *x)
ABSENT(EnterContinuousTimeMode, void *it)
ABSENT(CompletedIntegratorStep, void *it, bool forget, bool *event, bool *terminate)
ABSENT(SetTime, void *it, double x)
ABSENT(SetContinuousStates, void *it, const double *x, size_t n)
ABSENT(GetContinuousStateDerivatives, void *it, double *x, size_t n)
ABSENT(GetEventIndicators, void *it, double *x, size_t n)
ABSENT(GetContinuousStates, void *it, double *x, size_t n)
ABSENT(GetNominalsOfContinuousStates, void *it, double *x, size_t n)
ABSENT(GetNumberOfEventIndicators, void *it, size_t *n)
ABSENT(GetNumberOfContinuousStates, void *it, size_t *n)
ABSENT(EnterStepMode, void *it)
ABSENT(GetOutputDerivatives, void *it, refs r, size_t n, const int32_t *order, double *x, size_t m)
ABSENT(ActivateModelPartition, void *it, uint32_t clock, double time)
#endif
