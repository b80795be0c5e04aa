// A receiver built on Fast DDS, the default middleware of ROS 2: prints the topic and the bytes of every message.
//
//     g++ -std=c++14 fast_dds_peer.cpp -lfastdds -lfastcdr -o fast_dds_peer        Fast DDS 3
//     fast_dds_peer SECONDS TOPIC TYPE [TOPIC TYPE ...]
//
// Types are not declared here: the payload is printed as it arrived, in hexadecimal digits.
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>
#include <thread>
#include <vector>
#include <fastdds/dds/core/Entity.hpp>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/DataReaderListener.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/subscriber/qos/DataReaderQos.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>

using namespace eprosima::fastdds::dds;
using eprosima::fastdds::rtps::InstanceHandle_t;
using eprosima::fastdds::rtps::SerializedPayload_t;
using Bytes = std::vector<unsigned char>;

class RawType : public TopicDataType {
public:
    explicit RawType(const std::string& name) {
        set_name(name.c_str());
        max_serialized_type_size = 4 * 1024 * 1024;
        is_compute_key_provided = false;
    }
    bool serialize(const void* const, SerializedPayload_t&, DataRepresentationId_t) override { return false; }
    bool deserialize(SerializedPayload_t& payload, void* data) override {
        static_cast<Bytes*>(data)->assign(payload.data, payload.data + payload.length);
        return true;
    }
    uint32_t calculate_serialized_size(const void* const, DataRepresentationId_t) override { return max_serialized_type_size; }
    void* create_data() override { return new Bytes(); }
    void delete_data(void* data) override { delete static_cast<Bytes*>(data); }
    bool compute_key(SerializedPayload_t&, InstanceHandle_t&, bool) override { return false; }
    bool compute_key(const void* const, InstanceHandle_t&, bool) override { return false; }
};

class Printer : public DataReaderListener {
public:
    explicit Printer(std::string topic) : topic_(std::move(topic)) {}
    void on_data_available(DataReader* reader) override {
        Bytes data; SampleInfo info;
        while (reader->take_next_sample(&data, &info) == RETCODE_OK)
            if (info.valid_data) {
                std::printf("%s ", topic_.c_str());
                for (unsigned char b : data) std::printf("%02x", b);
                std::printf("\n"); std::fflush(stdout);
            }
    }
private:
    std::string topic_;
};

int main(int argc, char** argv) {
    const char* domain = std::getenv("ROS_DOMAIN_ID");
    auto* participant = DomainParticipantFactory::get_instance()->create_participant(
        domain ? std::atoi(domain) : 0, PARTICIPANT_QOS_DEFAULT);
    auto* subscriber = participant->create_subscriber(SUBSCRIBER_QOS_DEFAULT);
    for (int i = 2; i + 1 < argc; i += 2) {
        TypeSupport type(new RawType(argv[i + 1]));
        type.register_type(participant);
        auto* topic = participant->create_topic(argv[i], argv[i + 1], TOPIC_QOS_DEFAULT);
        DataReaderQos qos = DATAREADER_QOS_DEFAULT;
        qos.reliability().kind = RELIABLE_RELIABILITY_QOS;
        qos.history().kind = KEEP_LAST_HISTORY_QOS; qos.history().depth = 10;
        subscriber->create_datareader(topic, qos, new Printer(argv[i]));
    }
    std::this_thread::sleep_for(std::chrono::seconds(std::atoi(argv[1])));
    return 0;
}
