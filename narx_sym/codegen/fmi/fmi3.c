/* FMI 3.0 for co-simulation. */
#if defined FMI3_OVERRIDE_FUNCTION_PREFIX
#define FMI(name) FMI_EXPORT fmi_status fmi3##name
#define FMI_OTHER(kind, name) FMI_EXPORT kind fmi3##name
#else
#define FMI(name) FMI_EXPORT fmi_status FMI_PREFIXED(FMI_IDENTIFIER, _fmi3##name)
#define FMI_OTHER(kind, name) FMI_EXPORT kind FMI_PREFIXED(FMI_IDENTIFIER, _fmi3##name)
#endif
#define FMI_WHICH void *c, const unsigned int which[], size_t count

FMI_OTHER(const char *, GetVersion)(void) { return "3.0"; }
FMI(SetDebugLogging)(void *c, bool on, size_t count, const char *const categories[])
{
    (void)on, (void)count, (void)categories;
    return c ? fmi_ok : fmi_error;
}

FMI_OTHER(void *, InstantiateCoSimulation)(const char *name, const char *token, const char *resources, bool visible,
                                           bool logging, bool events, bool early, const unsigned int wanted[],
                                           size_t count, void *environment, fmi_log log, fmi_intermediate update)
{
    (void)resources, (void)visible, (void)logging, (void)early, (void)wanted, (void)count, (void)update;
    return events ? NULL : fmi_make(name, token, environment, log);
}
FMI_OTHER(void *, InstantiateModelExchange)(const char *name, const char *token, const char *resources, bool visible,
                                            bool logging, void *environment, fmi_log log)
{
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)environment, (void)log;
    return NULL;
}
FMI_OTHER(void *, InstantiateScheduledExecution)(const char *name, const char *token, const char *resources,
                                                 bool visible, bool logging, void *environment, fmi_log log,
                                                 fmi_clocked clock, fmi_lock lock, fmi_lock unlock)
{
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)environment, (void)log;
    (void)clock, (void)lock, (void)unlock;
    return NULL;
}
FMI_OTHER(void, FreeInstance)(void *c) { fmi_free((fmi_instance *)c); }

FMI(EnterInitializationMode)(void *c, bool given, double tolerance, double start, bool ends, double stop)
{
    (void)given, (void)tolerance, (void)ends, (void)stop;
    return fmi_enter((fmi_instance *)c, start);
}
FMI(ExitInitializationMode)(void *c) { return fmi_leave((fmi_instance *)c); }
FMI(Terminate)(void *c) { return fmi_end((fmi_instance *)c); }
FMI(Reset)(void *c) { return fmi_reset((fmi_instance *)c); }

FMI(GetFloat64)(FMI_WHICH, double values[], size_t many)
{
    return many == count ? fmi_get((fmi_instance *)c, which, count, values) : fmi_lacks((fmi_instance *)c);
}
FMI(SetFloat64)(FMI_WHICH, const double values[], size_t many)
{
    return many == count ? fmi_set((fmi_instance *)c, which, count, values) : fmi_lacks((fmi_instance *)c);
}
#define FMI_ABSENT(name, kind) \
    FMI(Get##name)(FMI_WHICH, kind values[], size_t many) \
    { \
        (void)which, (void)values, (void)many; \
        return fmi_none((fmi_instance *)c, count); \
    } \
    FMI(Set##name)(FMI_WHICH, kind const values[], size_t many) \
    { \
        (void)which, (void)values, (void)many; \
        return fmi_none((fmi_instance *)c, count); \
    }
FMI_ABSENT(Float32, float)
FMI_ABSENT(Int8, int8_t)
FMI_ABSENT(UInt8, uint8_t)
FMI_ABSENT(Int16, int16_t)
FMI_ABSENT(UInt16, uint16_t)
FMI_ABSENT(Int32, int32_t)
FMI_ABSENT(UInt32, uint32_t)
FMI_ABSENT(Int64, int64_t)
FMI_ABSENT(UInt64, uint64_t)
FMI_ABSENT(Boolean, bool)
FMI_ABSENT(String, const char *)
FMI(GetBinary)(FMI_WHICH, size_t sizes[], const uint8_t *values[], size_t many)
{
    return (void)which, (void)sizes, (void)values, (void)many, fmi_none((fmi_instance *)c, count);
}
FMI(SetBinary)(FMI_WHICH, const size_t sizes[], const uint8_t *const values[], size_t many)
{
    return (void)which, (void)sizes, (void)values, (void)many, fmi_none((fmi_instance *)c, count);
}
FMI(GetClock)(FMI_WHICH, bool values[]) { return (void)which, (void)values, fmi_none((fmi_instance *)c, count); }
FMI(SetClock)(FMI_WHICH, const bool values[])
{
    return (void)which, (void)values, fmi_none((fmi_instance *)c, count);
}

FMI(EnterStepMode)(void *c) { return fmi_lacks((fmi_instance *)c); }
FMI(DoStep)(void *c, double at, double length, bool kept, bool *event, bool *terminate, bool *early, double *reached)
{
    const fmi_status status = fmi_advance((fmi_instance *)c, length);
    (void)at, (void)kept;
    if (event) *event = false;
    if (terminate) *terminate = false;
    if (early) *early = false;
    if (reached && c) *reached = fmi_time((fmi_instance *)c);
    return status;
}
FMI(GetOutputDerivatives)(FMI_WHICH, const int32_t orders[], double values[], size_t many)
{
    (void)which, (void)orders, (void)values, (void)many;
    return count ? fmi_lacks((fmi_instance *)c) : fmi_ok;
}

FMI(EnterEventMode)(void *c) { return fmi_lacks((fmi_instance *)c); }
FMI(EnterConfigurationMode)(void *c) { return fmi_lacks((fmi_instance *)c); }
FMI(ExitConfigurationMode)(void *c) { return fmi_lacks((fmi_instance *)c); }
FMI(EvaluateDiscreteStates)(void *c) { return fmi_lacks((fmi_instance *)c); }
FMI(UpdateDiscreteStates)(void *c, bool *update, bool *terminate, bool *nominals, bool *states, bool *defined,
                          double *next)
{
    (void)update, (void)terminate, (void)nominals, (void)states, (void)defined, (void)next;
    return fmi_lacks((fmi_instance *)c);
}
FMI(GetNumberOfVariableDependencies)(void *c, unsigned int which, size_t *count)
{
    return (void)which, (void)count, fmi_lacks((fmi_instance *)c);
}
FMI(GetVariableDependencies)(void *c, unsigned int which, size_t elements[], unsigned int independents[],
                             size_t others[], fmi_dependency kinds[], size_t count)
{
    (void)which, (void)elements, (void)independents, (void)others, (void)kinds, (void)count;
    return fmi_lacks((fmi_instance *)c);
}
FMI(GetFMUState)(void *c, void **state) { return (void)state, fmi_lacks((fmi_instance *)c); }
FMI(SetFMUState)(void *c, void *state) { return (void)state, fmi_lacks((fmi_instance *)c); }
FMI(FreeFMUState)(void *c, void **state) { return (void)state, fmi_lacks((fmi_instance *)c); }
FMI(SerializedFMUStateSize)(void *c, void *state, size_t *size)
{
    return (void)state, (void)size, fmi_lacks((fmi_instance *)c);
}
FMI(SerializeFMUState)(void *c, void *state, uint8_t bytes[], size_t size)
{
    return (void)state, (void)bytes, (void)size, fmi_lacks((fmi_instance *)c);
}
FMI(DeserializeFMUState)(void *c, const uint8_t bytes[], size_t size, void **state)
{
    return (void)bytes, (void)size, (void)state, fmi_lacks((fmi_instance *)c);
}
#define FMI_DERIVATIVE(name) \
    FMI(name)(void *c, const unsigned int unknowns[], size_t many, const unsigned int knowns[], size_t count, \
              const double seed[], size_t seeds, double values[], size_t results) \
    { \
        (void)unknowns, (void)many, (void)knowns, (void)count, (void)seed, (void)seeds, (void)values, (void)results; \
        return fmi_lacks((fmi_instance *)c); \
    }
FMI_DERIVATIVE(GetDirectionalDerivative)
FMI_DERIVATIVE(GetAdjointDerivative)

/* There are no clocks. */
FMI(GetIntervalDecimal)(FMI_WHICH, double intervals[], fmi_qualifier qualifiers[])
{
    return (void)which, (void)intervals, (void)qualifiers, fmi_none((fmi_instance *)c, count);
}
FMI(GetIntervalFraction)(FMI_WHICH, uint64_t counters[], uint64_t resolutions[], fmi_qualifier qualifiers[])
{
    return (void)which, (void)counters, (void)resolutions, (void)qualifiers, fmi_none((fmi_instance *)c, count);
}
FMI(GetShiftDecimal)(FMI_WHICH, double shifts[]) { return (void)which, (void)shifts, fmi_none((fmi_instance *)c, count); }
FMI(GetShiftFraction)(FMI_WHICH, uint64_t counters[], uint64_t resolutions[])
{
    return (void)which, (void)counters, (void)resolutions, fmi_none((fmi_instance *)c, count);
}
FMI(SetIntervalDecimal)(FMI_WHICH, const double intervals[])
{
    return (void)which, (void)intervals, fmi_none((fmi_instance *)c, count);
}
FMI(SetIntervalFraction)(FMI_WHICH, const uint64_t counters[], const uint64_t resolutions[])
{
    return (void)which, (void)counters, (void)resolutions, fmi_none((fmi_instance *)c, count);
}
FMI(SetShiftDecimal)(FMI_WHICH, const double shifts[])
{
    return (void)which, (void)shifts, fmi_none((fmi_instance *)c, count);
}
FMI(SetShiftFraction)(FMI_WHICH, const uint64_t counters[], const uint64_t resolutions[])
{
    return (void)which, (void)counters, (void)resolutions, fmi_none((fmi_instance *)c, count);
}
FMI(ActivateModelPartition)(void *c, unsigned int clock, double time)
{
    return (void)clock, (void)time, fmi_lacks((fmi_instance *)c);
}

/* Model exchange is not offered; some importers look for its functions nevertheless. */
FMI(EnterContinuousTimeMode)(void *c) { return fmi_lacks((fmi_instance *)c); }
FMI(CompletedIntegratorStep)(void *c, bool kept, bool *event, bool *terminate)
{
    return (void)kept, (void)event, (void)terminate, fmi_lacks((fmi_instance *)c);
}
FMI(SetTime)(void *c, double time) { return (void)time, fmi_lacks((fmi_instance *)c); }
FMI(SetContinuousStates)(void *c, const double states[], size_t count)
{
    return (void)states, (void)count, fmi_lacks((fmi_instance *)c);
}
#define FMI_STATES(name) \
    FMI(name)(void *c, double values[], size_t count) \
    { \
        return (void)values, (void)count, fmi_lacks((fmi_instance *)c); \
    }
FMI_STATES(GetContinuousStateDerivatives)
FMI_STATES(GetEventIndicators)
FMI_STATES(GetContinuousStates)
FMI_STATES(GetNominalsOfContinuousStates)
FMI(GetNumberOfEventIndicators)(void *c, size_t *count) { return (void)count, fmi_lacks((fmi_instance *)c); }
FMI(GetNumberOfContinuousStates)(void *c, size_t *count) { return (void)count, fmi_lacks((fmi_instance *)c); }
