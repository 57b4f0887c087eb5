// SPDX-License-Identifier: MIT
// pearl_axi_slave in front of a memory of WORDS words that answers as the backbone does: whole words,
// PORT_LATENCY cycles later, read-only in its last READ_ONLY words, with a hole after it. A fetch is
// refused where the write would be.
module axi_memory
  import pearl_pkg::*;
#(
    parameter int unsigned DATA_WL = 32,
    parameter int unsigned WORDS = 64,
    parameter int unsigned READ_ONLY = 8,
    parameter int unsigned ADDR_BITS = 12,
    localparam int unsigned ID_BITS = 4,
    localparam int unsigned STRB_BITS = DATA_WL / 8
) (
    input  logic                 clk_i,
    input  logic                 rst_ni,
    input  logic [  ID_BITS-1:0] s_axi_awid,
    input  logic [ADDR_BITS-1:0] s_axi_awaddr,
    input  logic [          7:0] s_axi_awlen,
    input  logic [          2:0] s_axi_awsize,
    input  logic [          1:0] s_axi_awburst,
    input  logic                 s_axi_awvalid,
    output logic                 s_axi_awready,
    input  logic [  DATA_WL-1:0] s_axi_wdata,
    input  logic [STRB_BITS-1:0] s_axi_wstrb,
    input  logic                 s_axi_wlast,
    input  logic                 s_axi_wvalid,
    output logic                 s_axi_wready,
    output logic [  ID_BITS-1:0] s_axi_bid,
    output logic [          1:0] s_axi_bresp,
    output logic                 s_axi_bvalid,
    input  logic                 s_axi_bready,
    input  logic [  ID_BITS-1:0] s_axi_arid,
    input  logic [ADDR_BITS-1:0] s_axi_araddr,
    input  logic [          7:0] s_axi_arlen,
    input  logic [          2:0] s_axi_arsize,
    input  logic [          1:0] s_axi_arburst,
    input  logic                 s_axi_arvalid,
    output logic                 s_axi_arready,
    output logic [  ID_BITS-1:0] s_axi_rid,
    output logic [  DATA_WL-1:0] s_axi_rdata,
    output logic [          1:0] s_axi_rresp,
    output logic                 s_axi_rlast,
    output logic                 s_axi_rvalid,
    input  logic                 s_axi_rready
);

  localparam int unsigned WORD_ADDR_BITS = ADDR_BITS - $clog2(STRB_BITS);

  logic req, we, fetch, rvalid;
  logic [WORD_ADDR_BITS-1:0] addr;
  logic [DATA_WL-1:0] wdata, rdata, word;
  resp_e resp, answer;
  logic [DATA_WL-1:0] mem[WORDS];

  pearl_axi_slave #(
      .DATA_WL  (DATA_WL),
      .ADDR_BITS(ADDR_BITS),
      .ID_BITS  (ID_BITS)
  ) u_axi_slave (
      .req_o(req),
      .we_o(we),
      .fetch_o(fetch),
      .addr_o(addr),
      .wdata_o(wdata),
      .rvalid_i(rvalid),
      .rdata_i(rdata),
      .resp_i(resp),
      .*
  );

  always_comb begin
    answer = RespOkay;
    if (32'(addr) >= WORDS) answer = RespDecErr;
    else if ((we || fetch) && 32'(addr) >= WORDS - READ_ONLY) answer = RespSlvErr;
    word = answer == RespOkay ? mem[addr] : '0;
  end

  always_ff @(posedge clk_i) if (req && we && answer == RespOkay) mem[addr] <= wdata;

  // As at the port, a reset forgets what is under way.
  logic [PORT_LATENCY:1] valid_q;
  always_ff @(posedge clk_i) begin
    if (!rst_ni) valid_q <= '0;
    else valid_q <= {valid_q[PORT_LATENCY-1:1], req};
  end
  assign rvalid = valid_q[PORT_LATENCY];

  pearl_delay #(
      .WIDTH (DATA_WL + 2),
      .STAGES(PORT_LATENCY)
  ) u_delay (
      .clk_i,
      .d_i({answer, word}),
      .d_o({resp, rdata})
  );

endmodule
