// A memory that the host fills with one stream of bits and the pipeline takes rows from, in order.
//
// Host and pipeline share the read port: the host is served only while busy_i is low.
module pearl_input_bank
  import pearl_pkg::index_bits;
#(
    parameter int unsigned ROW_BITS = 48,
    parameter int unsigned DATA_WL = 32,
    parameter int unsigned WORDS = 3,
    localparam int unsigned ADDR_BITS = index_bits(WORDS)
) (
    input  logic                clk_i,
    input  logic                rst_ni,
    input  logic                busy_i,
    input  logic                start_i,
    output logic                valid_o,
    output logic [ROW_BITS-1:0] row_o,
    input  logic                take_i,

    input  logic                 host_re_i,
    input  logic                 host_we_i,
    input  logic [ADDR_BITS-1:0] host_addr_i,
    input  logic [  DATA_WL-1:0] host_wdata_i,
    output logic [  DATA_WL-1:0] host_rdata_o
);

  logic re;
  logic [ADDR_BITS-1:0] raddr;

  pearl_ram #(
      .WIDTH(DATA_WL),
      .DEPTH(WORDS)
  ) u_ram (
      .clk_i,
      .we_i   (host_we_i),
      .waddr_i(host_addr_i),
      .wdata_i(host_wdata_i),
      .re_i   (busy_i ? re : host_re_i),
      .raddr_i(busy_i ? raddr : host_addr_i),
      .rdata_o(host_rdata_o)
  );

  pearl_unpacker #(
      .ROW_BITS(ROW_BITS),
      .DATA_WL (DATA_WL),
      .WORDS   (WORDS)
  ) u_unpacker (
      .clk_i,
      .rst_ni,
      .start_i,
      .re_o   (re),
      .raddr_o(raddr),
      .rdata_i(host_rdata_o),
      .valid_o,
      .row_o,
      .take_i
  );

endmodule
